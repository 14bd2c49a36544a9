// A bearing judged from one uploaded vibration record: its speed, the multiples at which its parts would knock, a verdict.

import { forget } from "../charts/charts.js";
import { recordCharts } from "../charts/record_charts.js";
import { keptAddress } from "../lib/address.js";
import { call, path } from "../lib/api.js";
import { h, notify, once, panel, show } from "../lib/dom.js";
import { effectTitle } from "../lib/effect_titles.js";
import { badge, sentence, stateOf } from "../lib/parts.js";
import { uploadedRecords } from "../steps/record_step.js";
import { indicatorTable } from "./machine.js";

const LINES = {
  bpfi: "inner race, BPFI",
  bpfo: "outer race, BPFO",
  bsf: "ball, BSF",
  ftf: "cage, FTF",
};
const UNITS = { orders: "× shaft speed", hertz: "Hz" };
const KEPT = ["record", "baseline", "speed", "unit", ...Object.keys(LINES)];

export function bearingPage(place, query) {
  document.title = "Bearing · Residuum";
  const given = new URLSearchParams(query ?? "");
  const asked = Object.fromEntries(KEPT.map((key) => [key, given.get(key) ?? ""]));
  if (!(asked.unit in UNITS)) asked.unit = "orders";
  const form = h("div");
  const result = h("div", { class: "stack" });
  const keep = keptAddress();
  let records = [];
  let baselines = [];
  show(
    place,
    h(
      "div",
      { class: "title" },
      h("h1", {}, "Bearing"),
      h("p", { class: "muted about" }, "One vibration record in m/s², judged by the knocks of a rolling bearing's parts."),
    ),
    panel("Record and bearing", null, form),
    result,
  );

  async function score(event) {
    event?.preventDefault();
    keep(`#/bearing?${new URLSearchParams(KEPT.filter((key) => asked[key]).map((key) => [key, asked[key]]))}`);
    const lines = Object.keys(LINES)
      .filter((line) => Number(asked[line]) > 0)
      .map((line) => `${line}=${Number(asked[line])}`);
    const how = new URLSearchParams({
      ...(Number(asked.speed) > 0 ? { speed_rpm: asked.speed } : {}),
      ...(lines.length ? { [asked.unit]: lines.join(",") } : {}),
      ...(asked.baseline ? { baseline: asked.baseline } : {}),
    });
    try {
      const finding = await call(`${path("records", asked.record, "score", "bearing")}?${how}`, { method: "POST" });
      if (result.isConnected) drawFinding(finding);
    } catch (problem) {
      show(result, h("p", { class: "says-large above", role: "alert" }, problem.message));
    }
  }

  function drawFinding(finding) {
    const record = records.find((each) => String(each.id) === asked.record);
    for (const chart of result.querySelectorAll(".chart")) forget(chart);
    const part = finding.class && finding.verdict === "faulty" ? `Faulty: ${effectTitle(finding.class)}` : undefined;
    show(
      result,
      h("div", { class: "title" }, badge(stateOf(finding), part), h("p", { class: "says-large" }, sentence(finding))),
      asked.baseline
        ? null
        : h(
            "p",
            { class: "muted small" },
            "Without a baseline of healthy records only absolute limits are held, and the knocks of each part.",
          ),
      panel("Indicators", null, indicatorTable(finding)),
      panel(`Record ${record.id} · ${record.name.slice(0, 60)}`, null, recordCharts(record)),
    );
  }

  async function upload(file) {
    try {
      const record = await call(`/records?${new URLSearchParams({ filename: file.name })}`, { method: "POST", file });
      records.unshift(record);
      asked.record = String(record.id);
      drawForm();
    } catch (problem) {
      notify(problem.message);
    }
  }

  const keepValue = (key) => (event) => {
    asked[key] = event.target.value;
  };
  const choose = (key, label, options) =>
    h(
      "label",
      {},
      label,
      h(
        "select",
        { "data-key": key, onchange: keepValue(key) },
        options.map(([value, text]) => h("option", { value, selected: value === asked[key] }, text)),
      ),
    );
  const figure = (key, label, placeholder) =>
    h(
      "label",
      {},
      label,
      h("input", {
        type: "number",
        step: "any",
        min: 0,
        "data-key": key,
        value: asked[key],
        placeholder,
        oninput: keepValue(key),
      }),
    );

  function drawForm() {
    const file = h("input", {
      type: "file",
      "data-key": "bearing-file",
      "aria-label": "Upload a vibration record",
      onchange: () => upload(file.files[0]),
    });
    if (records.length && !records.some((each) => String(each.id) === asked.record)) asked.record = String(records[0].id);
    show(
      form,
      h(
        "form",
        { class: "fields", onsubmit: once(score) },
        h("label", {}, "upload a vibration record", file),
        choose(
          "record",
          "record",
          records.length
            ? records.map((each) => [String(each.id), `${each.id} · ${each.name.slice(0, 60)}`])
            : [["", "none yet"]],
        ),
        figure("speed", "shaft speed [rpm]", "from its channel"),
        choose("unit", "frequencies in", Object.entries(UNITS)),
        Object.entries(LINES).map(([key, label]) => figure(key, label, "not looked for")),
        choose("baseline", "held against", [
          ["", "absolute limits alone"],
          ...baselines.map((name) => [name, `baseline ${name}`]),
        ]),
        h("button", { "data-key": "score", disabled: !records.length }, "Score"),
      ),
    );
  }

  const start = async () => {
    const [known, trained] = await Promise.all([uploadedRecords(), call("/models?kind=baseline&limit=200")]);
    records = known;
    baselines = trained.items.map((each) => each.model);
    if (!form.isConnected) return;
    drawForm();
    if (given.get("record") && records.length) score();
  };
  start().catch((problem) => notify(problem.message));
  return () => {
    for (const chart of place.querySelectorAll(".chart")) forget(chart);
  };
}
