// Step 1: where the machine's signals come from. A table of registers is made into a register map.

import { call, described } from "../lib/api.js";
import { h, notify, once, panel, show } from "../lib/dom.js";
import { quantity, unitText } from "../lib/format.js";
import { diagnoserWith, plant } from "../lib/plant_state.js";
import { adapted, questionForm, schemaFields } from "../lib/question_form.js";
import { tableHead } from "../lib/table_head.js";

const NAME = "[A-Za-z0-9][A-Za-z0-9._\\-]{0,54}";
const KNOWN_OF_SOURCE = { kind: { label: "source", required: true, default: "can" }, channel: { required: true } };
const EXAMPLE = "name;register;type;unit;scale\nspeed;40001;uint16;rpm;0.1\n";

const HINT =
  "Say how the machine is reached, and choose the file that describes its bus. The next step shows what its signals read now.";

export async function sourceStep(place, way) {
  const { components } = await described();
  const before = way.settings?.sources[0];
  const texts = Object.entries(before ?? {}).map(([name, value]) => [name, String(value)]);
  const asked = { ...Object.fromEntries(texts), ...(way.machine ? { name: way.machine } : {}) };
  const ofText = schemaFields(components, "BusText");
  const ofSource = adapted(schemaFields(components, "SourceSettings"), ["map"], KNOWN_OF_SOURCE);
  const fields = {
    name: { type: "string", required: true, label: "name of the machine", pattern: NAME, examples: ["press-3"] },
    ...ofSource,
    ...withKindOfText(adapted(ofText, ["name", "text"])),
    length: {
      type: "number",
      label: "length of a window [s]",
      minimum: 0.1,
      required: true,
      default: way.settings?.window.length ?? 10,
    },
    diagnoser: {
      type: "string",
      required: true,
      description: "Who judges the windows.",
      enum: [...plant.diagnosers.keys()],
      default: way.settings?.diagnoser ?? diagnoserWith("tracks"),
    },
  };
  const file = h("input", {
    type: "file",
    accept: ".dbc,.yaml,.yml,.csv,.txt",
    "data-key": "map-file",
    onchange: () => takeFile(),
  });
  const text = h("textarea", { rows: 8, spellcheck: "false", class: "code", "aria-label": "Text of the description" });
  const found = h("div");
  let fileName = before?.map ?? "bus";
  let description = null;
  const question = questionForm(fields, asked, {
    first: ["name", "kind", "channel", "host", "port", "described_by", "sample_time", h("label", {}, "file", file), "length"],
    submit: h("button", { "data-key": "watch-machine" }, "Read this machine"),
    onsubmit: () => watch(),
    changed: offerExample,
  });

  function offerExample() {
    text.placeholder = question.body().described_by === "table" ? EXAMPLE : "";
  }

  async function takeFile() {
    fileName = file.files[0].name.replaceAll(/[^A-Za-z0-9._-]/g, "-");
    text.value = await file.files[0].text();
    await understand().catch((problem) => notify(problem.message));
  }

  async function understand() {
    const said = question.body();
    const body = { ...picked(said, ofText), kind: said.described_by, name: fileName, text: text.value };
    description = await call("/bus-descriptions", { method: "POST", body });
    show(found, signalTable(description));
  }

  const watch = once(async () => {
    try {
      if (text.value) await understand();
      const said = question.body();
      way.machine = said.name;
      await way.put({
        diagnoser: said.diagnoser,
        window: { cut: "sliding", length: said.length, step: said.length },
        sources: [{ ...picked(said, ofSource), map: description?.name ?? before?.map }],
        maps: description ? { [description.name]: description.text } : {},
      });
      way.go("signals");
    } catch (problem) {
      notify(problem.message);
    }
  });

  offerExample();
  show(
    place,
    panel(
      "Where do the signals come from?",
      null,
      before ? null : h("p", { class: "muted" }, HINT),
      question.form,
      h("details", { class: "editor" }, h("summary", {}, "Write or change the description here"), text),
      h("p", { class: "muted small next" }, "Nothing is sent to the machine. Windows are recorded from now on."),
    ),
    found,
  );
}

const picked = (said, fields) =>
  Object.fromEntries(
    Object.keys(fields)
      .filter((name) => name in said)
      .map((name) => [name, said[name]]),
  );

// How the source is described: the kinds that fit its own, and what counts with one of them.
function withKindOfText({ kind, ...others }) {
  const fitting = Object.entries(kind["x-of-source"]).map(([name, source]) => [name, [{ kind: [source] }]]);
  const renamed = Object.entries(others).map(([name, field]) => [
    name,
    { ...field, "x-only-with": field["x-only-with"]?.map((way) => ({ described_by: way.kind })) },
  ]);
  return { described_by: { ...kind, "x-choices-only-with": Object.fromEntries(fitting) }, ...Object.fromEntries(renamed) };
}

function signalTable(description) {
  const rows = description.streams.flatMap((stream) =>
    Object.entries(stream.channels).map(([name, unit]) =>
      h(
        "tr",
        {},
        h("td", { "data-label": "Signal" }, name),
        h("td", { "data-label": "Unit" }, unitText(unit) || "1"),
        h("td", { "data-label": "Every", class: "number" }, quantity(stream.sample_time, "s")),
      ),
    ),
  );
  return panel(
    `${description.name} describes`,
    null,
    h(
      "div",
      { class: "scroll" },
      h("table", { class: "reflow" }, tableHead(["Signal", "Unit", "Every"], [2]), h("tbody", {}, rows)),
    ),
    description.remarks.map((remark) => h("p", { class: "muted small" }, `${remark}.`)),
  );
}
