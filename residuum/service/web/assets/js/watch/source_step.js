// Step 1: where the machine's signals come from. A table of registers is made into a register map.

import { call } from "../lib/api.js";
import { h, notify, once, panel, show } from "../lib/dom.js";
import { quantity, unitText } from "../lib/format.js";
import { diagnoserWith } from "../lib/plant_state.js";
import { tableHead } from "../lib/table_head.js";

const KINDS = {
  can: { title: "CAN bus", maps: { dbc: "DBC file" } },
  modbus: { title: "Modbus TCP", maps: { table: "table of registers", registers: "register map (YAML)" } },
};
const EXAMPLE = "name;register;type;unit;scale\nspeed;40001;uint16;rpm;0.1\n";

const HINT =
  "Say how the machine is reached, and choose the file that describes its bus. The next step shows what its signals read now.";

export function sourceStep(place, way) {
  const before = way.settings?.sources[0];
  const field = (label, input) => h("label", {}, label, input);
  const name = h("input", {
    value: way.machine ?? "",
    required: true,
    pattern: "[A-Za-z0-9][A-Za-z0-9._\\-]{0,54}",
    placeholder: "press-3",
    "data-key": "name",
  });
  const kind = h(
    "select",
    { "data-key": "kind", onchange: () => redraw() },
    Object.entries(KINDS).map(([id, { title }]) => h("option", { value: id, selected: before?.kind === id }, title)),
  );
  const channel = h("input", { value: before?.channel ?? "", placeholder: "socketcan:can0", "data-key": "channel" });
  const host = h("input", { value: before?.host ?? "127.0.0.1", "data-key": "host" });
  const port = h("input", { type: "number", min: 1, max: 65535, value: before?.port ?? 502, "data-key": "port" });
  const every = h("input", { type: "number", min: 0.001, step: "any", value: 0.1, "data-key": "every" });
  const form = h("select", { "data-key": "map-kind", onchange: () => redraw() });
  const file = h("input", {
    type: "file",
    accept: ".dbc,.yaml,.yml,.csv,.txt",
    "data-key": "map-file",
    onchange: () => takeFile(),
  });
  const text = h("textarea", { rows: 8, spellcheck: "false", class: "code", "aria-label": "Text of the description" });
  const length = h("input", {
    type: "number",
    min: 0.1,
    step: "any",
    value: way.settings?.window.length ?? 10,
    "data-key": "length",
  });
  const fields = h("div", { class: "fields" });
  const found = h("div");
  let fileName = before?.map ?? "bus";
  let description = null;

  async function takeFile() {
    fileName = file.files[0].name.replaceAll(/[^A-Za-z0-9._-]/g, "-");
    text.value = await file.files[0].text();
    await understand().catch((problem) => notify(problem.message));
  }

  function redraw() {
    const { maps } = KINDS[kind.value];
    if (![...form.options].some((option) => option.value in maps))
      show(
        form,
        Object.entries(maps).map(([id, title]) => h("option", { value: id }, title)),
      );
    text.placeholder = form.value === "table" ? EXAMPLE : "";
    const own = kind.value === "can" ? [field("channel", channel)] : [field("host", host), field("port", port)];
    const polled = form.value === "table" ? [field("seconds between two reads", every)] : [];
    show(
      fields,
      field("name of the machine", name),
      field("source", kind),
      own,
      field("described by", form),
      polled,
      field("file", file),
      field("length of a window [s]", length),
    );
  }

  async function understand() {
    const body = { kind: form.value, name: fileName, text: text.value, sample_time: Number(every.value) };
    description = await call("/bus-descriptions", { method: "POST", body });
    show(found, signalTable(description));
  }

  const watch = once(async () => {
    try {
      if (text.value) await understand();
      way.machine = name.value;
      const source =
        kind.value === "can"
          ? { kind: "can", channel: channel.value }
          : { kind: "modbus", host: host.value, port: Number(port.value) };
      const map = description?.name ?? before?.map;
      const seconds = Number(length.value);
      await way.put({
        diagnoser: diagnoserWith("tracks"),
        window: { cut: "sliding", length: seconds, step: seconds },
        sources: [{ ...source, map }],
        maps: description ? { [description.name]: description.text } : {},
      });
      way.go("signals");
    } catch (problem) {
      notify(problem.message);
    }
  });

  redraw();
  show(
    place,
    panel(
      "Where do the signals come from?",
      null,
      before ? null : h("p", { class: "muted" }, HINT),
      h(
        "form",
        { class: "editor-form", onsubmit: watch },
        fields,
        h("details", { class: "editor" }, h("summary", {}, "Write or change the description here"), text),
        h(
          "p",
          { class: "controls next" },
          h("button", { "data-key": "watch-machine" }, "Read this machine"),
          h("span", { class: "muted small" }, "Nothing is sent to the machine. Windows are recorded from now on."),
        ),
      ),
    ),
    found,
  );
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
