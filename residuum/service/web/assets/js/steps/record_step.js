// Step 1: drop a record, choose a model, and say which column is which signal.

import { forget } from "../charts/charts.js";
import { recordCharts } from "../charts/record_charts.js";
import { call, path } from "../lib/api.js";
import { h, notify, once, panel, show } from "../lib/dom.js";
import { balanceEquation } from "../lib/equations.js";
import { count, quantity, span, unitText } from "../lib/format.js";
import { runIn } from "../lib/jobs.js";
import { modelName } from "../lib/model_name.js";
import { download } from "../lib/report_file.js";
import { tableHead } from "../lib/table_head.js";
import { DRIVE, offer, simulateIn } from "./example.js";
import { describe, modelTitle } from "./models.js";
import { optionsOf } from "./options.js";
import { parameterForm } from "./parameter_form.js";

const DERIVED = "derived: a comparison's signals";
const ENDINGS = ".csv,.txt,.tsv,.dat,.lvm,.npz,.parquet,.tdms,.mf4,.mat,.wav,.uff";
const TIME_FORMS = [
  "seconds",
  "milliseconds",
  "microseconds",
  "minutes",
  "hours",
  "epoch s",
  "epoch ms",
  "epoch us",
  "excel",
  "iso",
  "day first",
  "month first",
  "clock",
];
// Units that can be turned into each other, as far as a first guess needs them.
const ALIKE = [
  ["rad/s", "rpm", "1/min", "deg/s"],
  ["V", "mV", "kV"],
  ["A", "mA"],
  ["N", "kN"],
  ["m", "mm", "cm"],
  ["m/s", "mm/s", "km/h"],
  ["K", "°C", "degC"],
  ["W", "kW"],
  ["s", "ms"],
  ["m**3/s", "l/min", "l/s"],
  ["N*m", "N·m", "Nm"],
];

// Uploaded records, newest first, without those that comparisons made.
export async function uploadedRecords() {
  return (await call("/records?limit=200")).items.filter((record) => !record.notes.includes(DERIVED));
}

// A record's number → how lists of records name it.
export const recordTitles = (records) =>
  Object.fromEntries(records.map((each) => [each.id, `${each.id} · ${each.name.slice(0, 60)}`]));

export async function recordStep(place, bench) {
  const parts = { example: h("div"), record: h("div"), model: h("div"), signals: h("div"), map: h("div"), equations: h("div") };
  show(
    place,
    parts.example,
    h(
      "div",
      { class: "columns" },
      h("section", { class: "panel span-6" }, h("header", {}, h("h2", {}, "Record")), h("div", { class: "body" }, parts.record)),
      h("section", { class: "panel span-6" }, h("header", {}, h("h2", {}, "Model")), h("div", { class: "body" }, parts.model)),
    ),
    parts.signals,
    parts.map,
    parts.equations,
  );
  const [records, builtIn, stored] = await Promise.all([
    uploadedRecords(),
    call("/models/built-in/descriptions"),
    call("/models?kind=physical&limit=200"),
  ]);
  const known = { records, builtIn: builtIn.items, stored: stored.items };
  let drawing = 0;
  const redraw = async () => {
    if (!parts.record.isConnected) return; // the step has been left
    const mine = ++drawing; // a model described more slowly than the one chosen after it must not be drawn
    bench.save();
    bench.refresh();
    drawExample(parts.example, bench, known, redraw);
    drawRecord(parts.record, bench, known, redraw);
    drawModel(parts.model, bench, known, redraw);
    drawSignals(parts.signals, bench, known);
    await drawMap(parts, bench, known, redraw, () => mine === drawing && parts.map.isConnected).catch((problem) =>
      notify(problem.message),
    );
  };
  await redraw();
}

// Until there is a record and a model: one click gives both.
function drawExample(place, bench, known, redraw) {
  const begin = () =>
    simulateIn(
      place,
      DRIVE,
      (record) => {
        known.records.unshift(record);
        Object.assign(bench, { records: [record.id], model: DRIVE.machine, version: null, base: null, map: {} });
        return redraw();
      },
      bench.leaving,
    );
  const says =
    "Drop a record of your machine and choose its model, or try a simulated drive with friction that its model lacks. " +
    "Then press Compare; each step leads to the next.";
  show(place, bench.ready ? null : offer(says, "Try the example", begin));
}

function drawRecord(place, bench, known, redraw) {
  const input = h("input", {
    type: "file",
    multiple: true,
    accept: ENDINGS,
    class: "visually-hidden",
    id: "file",
    onchange: () => take([...input.files]),
  });
  const drop = h(
    "label",
    { class: "drop", for: "file", "data-key": "drop" },
    h("b", {}, "Drop a record here"),
    h("span", {}, " or choose a file"),
    h("span", { class: "muted small" }, "CSV and loggers' text files, NPZ, Parquet, TDMS, MDF4, MAT, WAV, UFF"),
  );
  const reading = readingForm(bench);
  const over = (on) => (event) => {
    event.preventDefault();
    drop.toggleAttribute("data-over", on);
  };
  drop.addEventListener("dragover", over(true));
  drop.addEventListener("dragleave", over(false));
  drop.addEventListener("drop", (event) => {
    over(false)(event);
    take([...event.dataTransfer.files]);
  });

  async function take(files) {
    const refusals = [];
    for (const file of files) {
      drop.setAttribute("aria-busy", "true");
      try {
        const query = new URLSearchParams([["filename", file.name], ...reading.said()]);
        const record = await call(`/records?${query}`, { method: "POST", file });
        known.records.unshift(record);
        bench.records = file === files[0] ? [record.id] : [...bench.records, record.id];
        bench.map = {};
      } catch (problem) {
        refusals.push(problem.message);
      }
    }
    for (const text of refusals) notify(text); // last: a file that is taken clears the messages before it
    redraw();
  }

  // Asks by its own text: the first press arms the button, the second deletes.
  async function remove(record, button) {
    if (button.textContent === "Delete") {
      button.textContent = "Delete for good?";
      return;
    }
    try {
      await call(path("records", record.id), { method: "DELETE" });
      known.records = known.records.filter((each) => each !== record);
      bench.records = bench.records.filter((each) => each !== record.id);
      redraw();
    } catch (problem) {
      notify(problem.message);
    }
  }

  const rows = known.records.map((record) =>
    h(
      "label",
      { class: "choice" },
      h("input", {
        type: "checkbox",
        "data-key": `record-${record.id}`,
        checked: bench.records.includes(record.id),
        onchange: (event) => {
          bench.records = event.target.checked
            ? [...bench.records, record.id]
            : bench.records.filter((each) => each !== record.id);
          bench.map = {};
          redraw();
        },
      }),
      h("span", { class: "name", title: record.name }, `${record.id} · ${record.name.slice(0, 120)}`),
      h("span", { class: "muted small" }, `${count(record.n)} samples, ${span(record.n * record.sample_time)}`),
      h(
        "button",
        {
          type: "button",
          class: "quiet small",
          "data-key": `delete-${record.id}`,
          "aria-label": `Delete record ${record.id}`,
          onclick: once((event) => remove(record, event.target)),
        },
        "Delete",
      ),
    ),
  );
  show(
    place,
    input,
    drop,
    reading.form,
    rows.length
      ? h("div", { class: "choices", role: "group", "aria-label": "Records" }, rows)
      : h("p", { class: "empty" }, "No record yet. Several records may be used together; each is a separate experiment."),
  );
}

// The records that are chosen, as they were read; what is drawn already stays as it is zoomed.
function drawSignals(place, bench, known) {
  const chosen = known.records.filter((each) => bench.records.includes(each.id));
  const ids = chosen.map((each) => each.id).join();
  if (place.dataset.records === ids) return;
  place.dataset.records = ids;
  for (const chart of place.querySelectorAll(".chart")) forget(chart);
  const about = (each) => `${count(each.n)} samples, one every ${quantity(each.sample_time, "s")}`;
  show(
    place,
    h(
      "div",
      { class: "stack" },
      chosen.map((each) => panel(`Record ${each.id} · ${each.name.slice(0, 60)}`, about(each), recordCharts(each))),
    ),
  );
}

// What a logger's file may leave open; said once, it holds for the files that are dropped after it.
function readingForm(bench) {
  bench.reading ??= {};
  const said = bench.reading;
  const keep = (name) => (event) => {
    said[name] = event.target.type === "checkbox" ? event.target.checked : event.target.value;
  };
  const choice = (name, label, values) =>
    h(
      "label",
      {},
      label,
      h(
        "select",
        { "data-key": `reading-${name}`, onchange: keep(name) },
        h("option", { value: "" }, "as the file shows"),
        values.map((value) => h("option", { value, selected: said[name] === value }, value)),
      ),
    );
  const written = (name, label, placeholder = "") =>
    h(
      "label",
      {},
      label,
      h("input", { "data-key": `reading-${name}`, value: said[name] ?? "", placeholder, onchange: keep(name) }),
    );
  const form = h(
    "details",
    { class: "editor", open: Object.values(said).some(Boolean) },
    h("summary", {}, "How to read a logger's file"),
    h(
      "div",
      { class: "controls" },
      choice("decimal", "decimal sign", [".", ","]),
      choice("time_form", "times are", TIME_FORMS),
      written("time_column", "time column"),
      written("sample_time", "seconds between samples", "where no column is a time"),
      written("unit", "units", "speed=rpm; force=N"),
      written("missing", "no value is", "OL; -999.9"),
      h(
        "label",
        {},
        h("input", {
          type: "checkbox",
          "data-key": "reading-resample",
          checked: said.resample ?? false,
          onchange: keep("resample"),
        }),
        "accept uneven steps (interpolated; longer holes stay missing)",
      ),
    ),
  );
  const several = ["unit", "missing"];
  const parts = (name, value) => (several.includes(name) ? value.split(";").map((part) => part.trim()) : [value]);
  const keys = () => Object.entries(said).flatMap(([name, value]) => parts(name, value || "").map((part) => [name, part]));
  return { form, said: () => keys().filter(([, value]) => value) };
}

function drawModel(place, bench, known, redraw) {
  const key = (model, version) => `${model} ${version ?? ""}`;
  const options = [...known.builtIn.map((each) => [each.model, null]), ...known.stored.map((each) => [each.model, each.number])];
  if (bench.model && !options.some(([model, version]) => key(model, version) === key(bench.model, bench.version)))
    options.push([bench.model, bench.version]);
  const select = h(
    "select",
    {
      id: "model",
      "data-key": "model",
      onchange: () => {
        const [model, version] = options[select.selectedIndex - 1] ?? [null, null];
        Object.assign(bench, { model, version, base: null, map: {} });
        redraw();
      },
    },
    h("option", { value: "" }, "choose a model …"),
    options.map(([model, version]) =>
      h(
        "option",
        { value: key(model, version), selected: key(model, version) === key(bench.model, bench.version) },
        version ? modelTitle(model, version) : `${model} (built in)`,
      ),
    ),
  );
  show(place, h("div", { class: "controls" }, h("label", { for: "model" }, "model"), select), editor(bench, known, redraw));
}

// The model file to read, edit and store under a name of its own.
function editor(bench, known, redraw) {
  const text = h("textarea", { rows: 16, spellcheck: "false", "aria-label": "Model file", class: "code" });
  const name = h("input", {
    value: `my-${bench.model ?? "model"}`.slice(0, 64),
    "aria-label": "Name of the model",
    pattern: "[A-Za-z0-9][A-Za-z0-9._\\-]{0,63}",
    required: true,
  });
  const file = h("input", {
    type: "file",
    accept: ".yaml,.yml",
    "aria-label": "Upload a model file",
    onchange: async () => {
      text.value = await file.files[0].text();
      name.value = modelName(file.files[0].name);
    },
  });
  const store = once(async () => {
    try {
      const made = await call(
        `/models?name=${encodeURIComponent(name.value)}&kind=physical&note=${encodeURIComponent("edited on the workbench")}`,
        { method: "POST", file: text.value },
      );
      bench.map = {};
      take(made, bench, known, redraw);
    } catch (problem) {
      notify(problem.message);
    }
  });
  const given = async () => {
    const { file: content } = await describe(bench.model, bench.version);
    text.value ||= content; // what was typed in the meantime stays
  };
  const details = h(
    "details",
    {
      class: "editor",
      ontoggle: () => {
        if (details.open && bench.model && !text.value) given().catch((problem) => notify(problem.message));
      },
    },
    h("summary", {}, "Upload or edit the model file"),
    h(
      "form",
      { class: "editor-form", onsubmit: store },
      file,
      text,
      h(
        "div",
        { class: "controls" },
        h("label", {}, "store as", name),
        h("button", {}, "Store"),
        h(
          "button",
          {
            type: "button",
            class: "quiet",
            onclick: () => download(`${bench.model ?? "model"}.yaml`, text.value, "application/yaml"),
          },
          "Download",
        ),
      ),
    ),
  );
  return details;
}

async function drawMap(parts, bench, known, redraw, current) {
  if (!bench.model) {
    show(parts.map);
    return show(parts.equations);
  }
  const description = await describe(bench.model, bench.version);
  if (!current()) return undefined;
  const record = known.records.find((each) => each.id === bench.records[0]);
  show(parts.equations, equations(description, bench, known, redraw));
  if (!record) return show(parts.map, h("p", { class: "empty" }, "Choose a record to go on."));
  const signals = [
    ...description.inputs.map((each) => ({ ...each, role: "input" })),
    ...description.outputs.map((each) => ({ ...each, role: "output", required: false })),
  ];
  const guesses = guess(signals, record.units);
  const chosen = Object.fromEntries(signals.map(({ name }) => [name, bench.map[name] ?? guesses[name]]));
  const take = () => {
    bench.map = Object.fromEntries(Object.entries(chosen).filter(([name, channel]) => channel && channel !== name));
    bench.save();
  };
  take();
  const row = (signal) =>
    h(
      "tr",
      {},
      h("td", { "data-label": "Model" }, h("span", {}, h("b", {}, signal.name), ` [${unitText(signal.unit) || "1"}]`)),
      h("td", { "data-label": "Role" }, signal.role),
      h(
        "td",
        { "data-label": "Column" },
        h(
          "select",
          {
            "aria-label": `Column for ${signal.name}`,
            "data-key": `map-${signal.name}`,
            onchange: (event) => {
              chosen[signal.name] = event.target.value;
              take();
            },
          },
          h("option", { value: "" }, signal.required ? "– choose –" : "not recorded"),
          Object.entries(record.units).map(([name, unit]) =>
            h(
              "option",
              { value: name, selected: name === chosen[signal.name] },
              `${name.slice(0, 60)} [${unitText(unit) || "1"}]`,
            ),
          ),
        ),
      ),
    );
  show(
    parts.map,
    panel(
      "Columns",
      "guessed by name and unit",
      h(
        "table",
        { class: "reflow" },
        tableHead(["Signal of the model", "Role", "Column of the record"]),
        h("tbody", {}, signals.map(row)),
      ),
      h(
        "p",
        { class: "next" },
        h("button", { type: "button", "data-key": "compare", onclick: () => bench.go("compare") }, "Compare"),
      ),
    ),
  );
}

// A column of the same name, else the only free one with a like unit, a shared word first.
function guess(signals, units) {
  const found = {};
  const free = new Set(Object.keys(units));
  const take = (signal, name) => {
    if (name !== undefined && !found[signal.name]) {
      found[signal.name] = name;
      free.delete(name);
    }
  };
  const lower = (text) => text.toLowerCase();
  const alike = (a, b) => a === b || ALIKE.some((group) => group.includes(a) && group.includes(b));
  for (const signal of signals)
    take(
      signal,
      [...free].find((name) => lower(name) === lower(signal.name)),
    );
  const fitting = (signal) => [...free].filter((name) => alike(units[name], signal.unit));
  for (const signal of signals)
    take(
      signal,
      fitting(signal).find((name) => lower(name).includes(lower(signal.name)) || lower(signal.name).includes(lower(name))),
    );
  for (const signal of signals) if (fitting(signal).length === 1) take(signal, fitting(signal)[0]);
  return found;
}

// The parameters from the chosen records, by the question `estimate`.
async function drawEstimation(place, bench, saveAs, stored) {
  const result = h("div");
  const known = { save_as: { default: saveAs, label: "store the estimate as", required: true } };
  const begin = () =>
    runIn(
      result,
      "Estimating the parameters",
      bench.address("estimate"),
      options.body(),
      (found) => stored({ model: found.stored.model, number: found.stored.version }),
      bench.leaving,
    );
  const options = await optionsOf(bench, "estimate", begin, { first: ["save_as"], submit: "Estimate from the records", known });
  show(place, options.form, result);
}

function equations(description, bench, known, redraw) {
  const saveAs = bench.version ? bench.model : `my-${bench.model}`.slice(0, 64);
  const stored = (made) => take(made, bench, known, redraw);
  const estimation = h("div", { class: "next stack" });
  if (bench.ready) drawEstimation(estimation, bench, saveAs, stored).catch((problem) => notify(problem.message));
  return h(
    "div",
    { class: "columns" },
    h(
      "section",
      { class: "panel span-5" },
      h("header", {}, h("h2", {}, "Balances")),
      h(
        "div",
        { class: "body stack" },
        description.balances.map((balance) =>
          h(
            "div",
            { class: "balance" },
            h("p", { class: "muted small" }, `${balance.name} [${unitText(balance.unit) || "1"}]`),
            h(
              "div",
              { class: "scroll", tabindex: 0, role: "group", "aria-label": `Balance ${balance.name}` },
              balanceEquation(
                balance,
                description.effects.filter((use) => use.target === balance.name),
              ),
            ),
          ),
        ),
      ),
    ),
    h(
      "section",
      { class: "panel span-7" },
      h("header", {}, h("h2", {}, "Parameters"), h("div", { class: "aside" }, "fixed ones are not estimated")),
      h("div", { class: "body" }, parameterForm(description, saveAs, stored), estimation),
    ),
  );
}

// A newly stored version becomes the model of the bench.
export function take(made, bench, known, redraw) {
  known.stored = [...known.stored.filter((each) => each.model !== made.model), made];
  Object.assign(bench, { model: made.model, version: made.number, base: null });
  redraw();
}
