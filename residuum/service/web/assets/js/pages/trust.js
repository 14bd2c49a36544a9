// How far an identified model is to be trusted: W_T over drawn models, the residual generator it allows, and its characteristic.

import { draw, series, tones } from "../charts/charts.js";
import { call, path } from "../lib/api.js";
import { h, notify, show } from "../lib/dom.js";
import { capital, inBrackets, number, quantity, unitText } from "../lib/format.js";
import { runIn } from "../lib/jobs.js";
import { adapted, fieldsOf, questionForm } from "../lib/question_form.js";
import { recordTitles } from "../steps/record_step.js";

const KEPT = "residual_"; // before the names of the residual's fields in the address
const LEGEND = { showlegend: true, legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 } };
const chart = (label, kind = "chart tall") => h("div", { class: kind, role: "figure", "aria-label": label });
const part = (span, title, aside, ...body) =>
  h(
    "section",
    { class: `panel ${span}` },
    h("header", {}, h("h2", {}, title), aside ? h("div", { class: "aside" }, aside) : null),
    h("div", { class: "body" }, ...body),
  );

// `bench` = { records, asked, set(change), leaving }: `asked` is what the address keeps, `watch` the record that was run on.
export function trustPanels(model, bench) {
  const place = h("div", { class: "stack" });
  drawForms(place, model, bench).catch((problem) => notify(problem.message));
  return place;
}

async function drawForms(place, model, bench) {
  const [ofWeight, ofResidual] = await Promise.all([
    fieldsOf("/models/{model}/uncertainty"),
    fieldsOf("/models/{model}/residual-views"),
  ]);
  const weight = chart("Uncertainty weight");
  const about = h("p", { class: "muted small" });
  const result = h("div", { class: "stack" });
  const { model: name, version } = model.stored;
  const uncertainty = questionForm(
    adapted(ofWeight, ["model", "version"]),
    {},
    {
      first: [],
      scope: "weight-",
      more: "Models drawn, order, frequencies, form",
      submit: h("button", { "data-key": "weight" }, "Draw the weight"),
      onsubmit: () => fetchWeight().catch((problem) => notify(problem.message)),
    },
  );
  async function fetchWeight() {
    const query = new URLSearchParams({ version, ...uncertainty.body() });
    await drawWeight(weight, about, await call(`${path("models", name, "uncertainty")}?${query}`));
  }
  const { asked } = bench;
  const kept = Object.entries(asked).filter(([key]) => key.startsWith(KEPT));
  const own = { record: asked.watch, ...Object.fromEntries(kept.map(([key, text]) => [key.slice(KEPT.length), text])) };
  const records = bench.records.map((each) => String(each.id));
  const known = {
    record: { enum: records, titles: recordTitles(bench.records), label: "run on record", default: records[0] },
    offset: { label: `sensor offset of the characteristic${inBrackets(model.output.unit)}` },
  };
  const residual = questionForm(adapted(ofResidual, ["healthy", "version"], known), own, {
    first: ["record", "offset"],
    scope: "residual-",
    submit: h("button", { "data-key": "design" }, "Design and run"),
    onsubmit: design,
    changed: (field) => bench.set({ [KEPT + field]: own[field] }),
  });
  function design() {
    const { record, ...said } = residual.body();
    bench.set({ watch: record });
    runIn(
      result,
      "Designing the residual generator",
      path("models", name, "residual-views"),
      { ...said, healthy: [Number(asked.record)], record: Number(record), version },
      (view) => drawResidual(result, view),
      bench.leaving,
    );
  }
  show(
    place,
    part("", "Uncertainty weight", "error of models that the data allow", uncertainty.form, weight, about),
    part("", "Residual generator", "what the model does not explain, with its threshold", residual.form, result),
  );
  if (asked.watch) design();
  await fetchWeight();
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
