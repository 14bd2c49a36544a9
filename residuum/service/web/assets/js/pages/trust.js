// How far an identified model is to be trusted: W_T over drawn models, the residual generator it allows, and its characteristic.

import { draw, series, tones } from "../charts/charts.js";
import { call, path } from "../lib/api.js";
import { h, notify, show } from "../lib/dom.js";
import { capital, inBrackets, number, quantity, unitText } from "../lib/format.js";
import { runIn } from "../lib/jobs.js";
import { WEIGHT, weightFields, weightParameters } from "../steps/weight_form.js";

const FORMS = {
  multiplicative: "multiplicative, |G/Ĝ₀ − 1|",
  additive: "additive, |G − Ĝ₀|",
  "inverse-multiplicative": "inverse multiplicative, |Ĝ₀/G − 1|",
};
const LEGEND = { showlegend: true, legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 } };
const chart = (label, kind = "chart tall") => h("div", { class: kind, role: "img", "aria-label": label });
const part = (span, title, aside, ...body) =>
  h(
    "section",
    { class: `panel ${span}` },
    h("header", {}, h("h2", {}, title), aside ? h("div", { class: "aside" }, aside) : null),
    h("div", { class: "body" }, ...body),
  );

// `bench` = { records, record, offset, save(), leaving }: what the address keeps.
export function trustPanels(model, bench) {
  const weight = chart("Uncertainty weight");
  const about = h("p", { class: "muted small" });
  const result = h("div", { class: "stack" });
  const { stored } = model;
  const record = h(
    "select",
    { "data-key": "residual-record", onchange: () => bench.set({ watch: record.value }) },
    bench.records.map((each) =>
      h("option", { value: each.id, selected: String(each.id) === bench.watch }, `${each.id} · ${each.name.slice(0, 60)}`),
    ),
  );
  const offset = h("input", {
    type: "number",
    step: "any",
    min: 0,
    "data-key": "offset",
    placeholder: "twice the noise",
    onchange: () => bench.set({ offset: offset.value }),
    value: bench.offset ?? "",
  });
  const design = (event) => {
    event?.preventDefault();
    bench.set({ watch: record.value });
    const body = {
      healthy: [Number(bench.healthy)],
      record: Number(record.value),
      version: stored.version,
      ...(Number(offset.value) > 0 ? { offset: Number(offset.value) } : {}),
    };
    runIn(
      result,
      "Designing the residual generator",
      path("models", stored.model, "residual-views"),
      body,
      (view) => drawResidual(result, view),
      bench.leaving,
    );
  };
  const chosen = { ...WEIGHT, form: "multiplicative" };
  const pickForm = (event) => {
    chosen.form = event.target.value;
  };
  const options = Object.entries(FORMS).map(([value, text]) => h("option", { value }, text));
  const form = h("label", {}, "error bounded", h("select", { "data-key": "weight-form", onchange: pickForm }, options));
  const fetchWeight = (event) => {
    event?.preventDefault();
    const query = new URLSearchParams({ version: stored.version, form: chosen.form, ...weightParameters(chosen) });
    call(`${path("models", stored.model, "uncertainty")}?${query}`)
      .then((found) => drawWeight(weight, about, found))
      .catch((problem) => notify(problem.message));
  };
  const again = h("button", { "data-key": "weight" }, "Draw the weight");
  const chooser = h("form", { class: "fields", onsubmit: fetchWeight }, weightFields(chosen, [form, again]));
  const choices = h(
    "details",
    {},
    h("summary", { "data-key": "weight-more" }, "Models drawn, order, frequencies, form"),
    chooser,
  );
  fetchWeight();
  if (bench.watch) queueMicrotask(design);
  return h(
    "div",
    { class: "stack" },
    part("", "Uncertainty weight", "error of models that the data allow", choices, weight, about),
    part(
      "",
      "Residual generator",
      "what the model does not explain, with its threshold",
      h(
        "form",
        { class: "controls", onsubmit: design },
        h("label", {}, "run on record", record),
        h("label", {}, `sensor offset of the characteristic${inBrackets(model.output.unit)}`, offset),
        h("button", { "data-key": "design" }, "Design and run"),
      ),
      result,
    ),
  );
}

function drawWeight(place, about, found) {
  const [blue, orange] = series();
  const gaps = (rows) => rows.flatMap((row) => [...row, null]);
  const drawn = {
    type: "scatter",
    mode: "lines",
    name: "drawn models",
    x: gaps(found.samples.map(() => found.frequency)),
    y: gaps(found.samples),
    line: { width: 0.8, color: `${blue}66` },
    hoverinfo: "skip",
  };
  const largest = {
    type: "scatter",
    mode: "lines",
    name: "largest of all",
    x: found.sampled_frequency,
    y: found.largest,
    line: { width: 1.6, color: blue, dash: "dot" },
    hovertemplate: "%{x:.4~g} Hz<br>%{y:.3~g}<extra></extra>",
  };
  const weight = {
    type: "scatter",
    mode: "lines",
    name: "|W_T|",
    x: found.frequency,
    y: found.weight,
    line: { width: 2.4, color: orange },
    hovertemplate: "%{x:.4~g} Hz<br>%{y:.3~g}<extra></extra>",
  };
  const critical = found.critical_frequency;
  const ends =
    critical === null
      ? "The weight stays below 1."
      : `From ${quantity(critical, "Hz")} on the weight is 1 or more: nothing can be promised there.`;
  about.textContent = `${capital(found.promise)}. ${ends}`;
  return draw(place, [drawn, largest, weight], {
    x: { title: { text: "frequency [Hz]" }, type: "log", range: [found.frequency[0], found.frequency.at(-1)].map(Math.log10) },
    y: { title: { text: found.form === "additive" ? "error" : "relative error" }, type: "log", exponentformat: "e", dtick: 1 },
    more: {
      ...LEGEND,
      margin: { l: 64, r: 12, t: 34, b: 42 },
      shapes: [
        { type: "line", xref: "paper", x0: 0, x1: 1, y0: 1, y1: 1, line: { dash: "dash", width: 1, color: tones().limit } },
      ],
    },
  });
}

function drawResidual(place, view) {
  const over = chart("Residual and threshold", "chart overlay");
  const roc = chart("Operating characteristic");
  const alarm = view.alarm_time === null ? "No alarm." : `Alarm at ${quantity(view.alarm_time, "s")}.`;
  show(
    place,
    h("p", { class: "says-large" }, alarm),
    h(
      "p",
      { class: "muted small" },
      `${capital(view.guarantee)}. Post-filter of order ${view.filter_order}, β/γ = ${number(view.decoupling)}.`,
    ),
    over,
    h("h3", {}, "Receiver operating characteristic"),
    h(
      "p",
      { class: "muted small" },
      `A sensor offset of ${quantity(view.roc.offset, view.unit)} on the healthy record, judged sample by sample by ` +
        `the RMS of the residual; area under the curve ${number(view.roc.area)}.`,
    ),
    roc,
  );
  const [blue, orange, green] = series();
  const line = (x, y, colour, more) => ({
    type: "scatter",
    mode: "lines",
    x,
    y,
    line: { width: 1.1, color: colour },
    hovertemplate: "%{x:.5~g} s<br>%{y:.4~g}<extra></extra>",
    ...more,
  });
  const twice = view.time.flatMap((each) => [each, each]);
  const band = view.time.flatMap((_, index) => [view.lowest[index], view.highest[index]]);
  const lower = { yaxis: "y2" };
  const limit = { line: { dash: "dash", width: 1.5, color: tones().limit } };
  draw(
    over,
    [
      line(twice, band, blue, { name: "residual" }),
      line(view.time, view.statistic, orange, { name: "statistic", ...lower }),
      line(view.time, view.threshold, "", { name: "threshold", ...lower, ...limit }),
    ],
    {
      x: { title: { text: "time [s]" }, exponentformat: "SI", anchor: "y2" },
      y: { title: { text: `residual${inBrackets(view.unit)}` }, domain: [0.52, 1], exponentformat: "SI" },
      y2: {
        title: { text: `statistic${unitText(view.threshold_unit) ? inBrackets(view.threshold_unit) : ""}` },
        domain: [0, 0.44],
        rangemode: "tozero",
      },
      more: { ...LEGEND, margin: { l: 64, r: 12, t: 34, b: 42 } },
    },
  ).catch((error) => notify(error.message));
  draw(
    roc,
    [
      line(view.roc.false_alarms, view.roc.detections, green, {
        name: "residual",
        line: { width: 2.2, color: green },
        hovertemplate: "%{x:.3~g} false alarms<br>%{y:.3~g} detections<extra></extra>",
      }),
      line([0, 1], [0, 1], "", { name: "chance", line: { dash: "dot", width: 1, color: tones().limit }, hoverinfo: "skip" }),
    ],
    {
      x: { title: { text: "share of healthy samples above" }, range: [0, 1] },
      y: { title: { text: "share of faulty samples above" }, range: [0, 1.02] },
      more: { ...LEGEND, margin: { l: 64, r: 12, t: 34, b: 42 } },
    },
  ).catch((error) => notify(error.message));
}
