// What the residuals say against an identified model, and where its poles and zeros lie.

import { draw, series, tones } from "../charts/charts.js";
import { call, path } from "../lib/api.js";
import { h, notify, panel } from "../lib/dom.js";
import { number, percent } from "../lib/format.js";

const chart = (label) => h("div", { class: "chart tall", role: "figure", "aria-label": label });
const half = (title, aside, ...body) =>
  h(
    "section",
    { class: "panel span-6" },
    h("header", {}, h("h2", {}, title), aside ? h("div", { class: "aside" }, aside) : null),
    h("div", { class: "body" }, ...body),
  );

export function checkPanels(model) {
  const part = model.check?.parts[0];
  const tests = [
    ["Residual's own correlation", part?.whiteness, "A method without a noise model does not claim that its residual is white."],
    ["Residual and past input", part?.input_correlation, "There is no input correlation of this model."],
  ];
  const level = percent(1 - (model.check?.level ?? 0.01));
  const drawn = tests.map(([title, test, none]) => {
    const place = chart(title);
    if (test) queueMicrotask(() => drawCorrelation(place, test).catch((problem) => notify(problem.message)));
    const says = !test
      ? none
      : `${test.passed ? "Within" : "Beyond"} what chance gives: p = ${number(test.p_value)} over ${test.lags.length} lags.`;
    return half(title, `dashed: ${level} band of each lag`, test ? place : null, h("p", { class: "muted small" }, says));
  });
  const reasons = model.check?.reasons ?? [];
  return h(
    "div",
    { class: "stack" },
    part
      ? h("div", { class: "columns" }, drawn)
      : panel("Residuals", null, h("p", { class: "empty" }, reasons[0] ?? "No data was kept aside to test the residuals on.")),
    polesAndZeros(model),
  );
}

function drawCorrelation(place, { lags, correlation, band }) {
  const limit = Array.isArray(band) ? Math.max(...band) : band;
  const edge = (at) => ({
    type: "line",
    xref: "paper",
    x0: 0,
    x1: 1,
    y0: at,
    y1: at,
    line: { dash: "dash", width: 1, color: tones().limit },
  });
  const beyond = correlation.map((value) => Math.abs(value) > limit);
  const bars = {
    type: "bar",
    x: lags,
    y: correlation,
    marker: { color: beyond.map((is) => (is ? tones().faulty : series()[0])) },
    hovertemplate: "lag %{x}<br>%{y:.3~g}<extra></extra>",
  };
  const reach = 1.2 * Math.max(limit, ...correlation.map(Math.abs));
  return draw(place, [bars], {
    x: { title: { text: "lag [samples]" } },
    y: { title: { text: "correlation" }, range: [-reach, reach] },
    more: { shapes: [edge(limit), edge(-limit)], bargap: 0.6 },
  });
}

function polesAndZeros(model) {
  const place = chart("Poles and zeros");
  const about = h("p", { class: "muted small" });
  const element = half("Poles and zeros", "× poles   ○ zeros", place, about);
  const at = `${path("models", model.stored.model, "poles-and-zeros")}?version=${model.stored.version}`;
  call(at)
    .then((found) => drawPlane(place, about, found))
    .catch((problem) => notify(problem.message));
  return h("div", { class: "columns" }, element);
}

function drawPlane(place, about, { poles, zeros }) {
  if (!poles) {
    place.remove();
    about.textContent =
      "This method estimates an impulse response, which has no poles or zeros of its own; ARX or output error have.";
    return undefined;
  }
  const largest = Math.max(0, ...poles.map(({ magnitude }) => magnitude));
  about.textContent =
    largest < 1 ? `Stable: every pole lies within the unit circle, the outermost at ${number(largest)}.` : "Not stable.";
  const [blue, orange] = series();
  const points = (found, symbol, color, name) => ({
    type: "scatter",
    mode: "markers",
    name,
    x: found.map(({ real }) => real),
    y: found.map(({ imaginary }) => imaginary),
    marker: { symbol, color, size: 11, line: { width: 2, color } },
    hovertemplate: `${name} %{x:.4~g} + %{y:.4~g} j<extra></extra>`,
  });
  const circle = { type: "circle", x0: -1, x1: 1, y0: -1, y1: 1, line: { width: 1, dash: "dash", color: tones().limit } };
  return draw(place, [points(poles, "x-thin", orange, "pole"), points(zeros, "circle-open", blue, "zero")], {
    x: { title: { text: "real part" }, range: [-1.6, 1.6] },
    y: { title: { text: "imaginary part" }, scaleanchor: "x", range: [-1.2, 1.2] },
    more: { shapes: [circle] },
  });
}
