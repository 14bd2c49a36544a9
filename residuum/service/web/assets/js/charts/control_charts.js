// Charts of a robust design: its Pareto front, constraints, open loop and step responses.

import { unitText } from "../lib/format.js";
import { draw, series, tones } from "./charts.js";

const LEGEND = {
  showlegend: true,
  legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 },
  margin: { l: 64, r: 12, t: 34, b: 42 },
};
const LEAST_SHARE = 3e-4; // of the Nyquist frequency: below lies only the integrator
const PHASE_MARGIN_LINE = -180;

const line = (x, y, colour, more = {}) => ({
  type: "scatter",
  mode: "lines",
  x,
  y,
  line: { width: 2, color: colour },
  hovertemplate: "%{x:.4~g}<br>%{y:.4~g}<extra></extra>",
  ...more,
});
const between = (x, low, high, colour, more) => ({
  type: "scatter",
  mode: "lines",
  x: [...x, ...x.toReversed()],
  y: [...high, ...low.toReversed()],
  fill: "toself",
  fillcolor: `${colour}38`,
  line: { width: 0 },
  hoverinfo: "skip",
  ...more,
});

const hertz = (frequency) => ({
  title: { text: "frequency [Hz]" },
  type: "log",
  exponentformat: "SI",
  range: [Math.log10(Math.max(frequency[0], LEAST_SHARE * frequency.at(-1))), Math.log10(frequency.at(-1))],
});

export async function drawFront(place, view, chosen, choose) {
  const [blue, orange] = series();
  const nominal = view.aim === "nominal";
  const x = view.points.map((point) => point.second);
  const y = view.points.map((point) => (nominal ? 100 * point.first : point.first));
  const trace = {
    type: "scatter",
    mode: "lines+markers",
    x,
    y,
    line: { width: 1, dash: "dot", color: blue },
    marker: {
      size: x.map((_, index) => (index === chosen ? 16 : 10)),
      symbol: x.map((_, index) => (index === chosen ? "diamond" : "circle")),
      color: x.map((_, index) => (index === chosen ? orange : blue)),
    },
    hovertemplate: nominal
      ? "settling %{x:.4~g} s<br>overshoot %{y:.3~g} %<extra></extra>"
      : "%{x:.4~g} rad/s<br>%{y:.3~g} dB<extra></extra>",
  };
  await draw(place, [trace], {
    x: {
      title: { text: nominal ? "settling time ℓ [s]" : "critical frequency ω_c [rad/s]" },
      exponentformat: "SI",
      ...(x.length > 1 ? {} : { range: [0, 2 * x[0]] }),
    },
    y: {
      title: { text: nominal ? "overshoot [%]" : "high-frequency gain h_g [dB]" },
      ...(y.length > 1 ? {} : { range: [0, 2 * y[0]].sort((a, b) => a - b) }),
    },
  });
  if (!place.removeAllListeners) return;
  place.removeAllListeners("plotly_click");
  place.on("plotly_click", ({ points }) => {
    if (points[0]) choose(points[0].pointNumber);
  });
}

// y above, and below it u, what the controller asks of the actuator for the same step; `limits` are the actuator's, null: none.
export function drawSteps(place, view, point, limits) {
  const [blue, orange] = series();
  const { time, drawn, nominal, control } = point.steps;
  const cloud = (rows, more) => ({
    ...line(
      rows.flatMap(() => [...time, null]),
      rows.flatMap((row) => [...row, null]),
      `${blue}59`,
      { name: "drawn plants", hoverinfo: "skip", hovertemplate: null, ...more },
    ),
    line: { width: 1, color: `${blue}59` },
  });
  const middle = (values, more) =>
    line(time, values, orange, {
      name: "plant in the middle",
      line: { width: 2.4, color: orange },
      hovertemplate: "%{x:.4~g} s<br>%{y:.4~g}<extra></extra>",
      ...more,
    });
  const wild = drawn.flat().some((value) => value === null || Math.abs(value) > 4);
  const asked = control.nominal.filter(Number.isFinite);
  const reach = 2 * Math.max(...asked.map(Math.abs));
  const limit = (at, yref = "y") => ({
    type: "line",
    xref: "paper",
    yref,
    x0: 0,
    x1: 1,
    y0: at,
    y1: at,
    line: { dash: "dot", width: 1, color: tones().limit },
  });
  const lower = { yaxis: "y2", showlegend: false };
  const unit = unitText(view.input.unit).slice(0, 24) || "1";
  const per = unitText(view.output.unit).slice(0, 24) || "1";
  return draw(place, [cloud(drawn), middle(nominal), cloud(control.drawn, lower), middle(control.nominal, lower)], {
    x: { title: { text: "time [s]" }, exponentformat: "SI", anchor: "y2" },
    y: {
      title: { text: `${view.output.name.slice(0, 40)} ÷ step` },
      domain: [0.46, 1],
      ...(wild ? { range: [-0.5, 3] } : {}),
    },
    y2: {
      title: { text: `${view.input.name.slice(0, 40)} [${unit} / ${per}]` },
      domain: [0, 0.36],
      exponentformat: "SI",
      ...(wild ? { range: [-reach, reach] } : {}),
    },
    more: {
      ...LEGEND,
      shapes: [limit(0.98), limit(1.02), ...limits.filter(Number.isFinite).map((each) => limit(each, "y2"))],
    },
  });
}

// |S| and |T| below their bounds, and the whole cost below its limit (Fig. 46 of the source).
export function drawConstraints(place, view, point) {
  const [blue, orange, green] = series();
  const { frequency, limit } = view;
  const dashed = { width: 1.6, dash: "dash", color: tones().limit };
  const bound = (weight) => weight.map((value) => limit / value);
  const seen = (values) => values.filter((_, index) => frequency[index] >= LEAST_SHARE * frequency.at(-1) && values[index] > 0);
  const span = (values) => [
    Math.floor(Math.log10(Math.max(Math.min(...seen(values)), 1e-6))),
    Math.ceil(Math.log10(2 * Math.max(...values))),
  ];
  const sum = view.aim === "nominal" ? "‖[W_S S; W_T T]‖" : "|W_S S| + |W_T T|";
  return draw(
    place,
    [
      line(frequency, point.S, blue, { name: "|S|" }),
      line(frequency, bound(point.W_S), "", { name: "bounds", line: dashed }),
      line(frequency, point.T, orange, { name: "|T|", yaxis: "y2" }),
      line(frequency, bound(point.W_T), "", { yaxis: "y2", line: dashed, showlegend: false }),
      line(frequency, point.total, green, { name: sum, yaxis: "y3" }),
      line([frequency[0], frequency.at(-1)], [limit, limit], "", { yaxis: "y3", line: dashed, showlegend: false }),
    ],
    {
      x: { ...hertz(frequency), anchor: "y3" },
      y: { title: { text: "|S|" }, type: "log", domain: [0.7, 1], exponentformat: "e", dtick: 1, range: span(point.S) },
      y2: { title: { text: "|T|" }, type: "log", domain: [0.36, 0.64], exponentformat: "e", dtick: 1, range: span(point.T) },
      y3: { title: { text: "cost" }, domain: [0, 0.3], range: [0, 1.2 * Math.max(limit, ...point.total)] },
      more: LEGEND,
    },
  );
}

export function drawLoop(place, view, { loop }) {
  const [blue, orange] = series();
  const { frequency } = view;
  const lower = { yaxis: "y2" };
  const at = (level, axis) => ({
    type: "line",
    xref: "paper",
    yref: axis,
    x0: 0,
    x1: 1,
    y0: level,
    y1: level,
    line: { dash: "dash", width: 1, color: tones().limit },
  });
  return draw(
    place,
    [
      between(frequency, loop.lowest, loop.highest, blue, { name: "range", showlegend: false }),
      line(frequency, loop.magnitude, blue, { name: "|L|" }),
      between(frequency, loop.lowest_phase, loop.highest_phase, orange, { ...lower, name: "range", showlegend: false }),
      line(frequency, loop.phase, orange, { ...lower, name: "phase of L" }),
    ],
    {
      x: { ...hertz(frequency), anchor: "y2" },
      y: { title: { text: "|L|" }, type: "log", domain: [0.48, 1], exponentformat: "e" },
      y2: { title: { text: "phase [°]" }, domain: [0, 0.4] },
      more: { ...LEGEND, shapes: [at(1, "y"), at(PHASE_MARGIN_LINE, "y2")] },
    },
  );
}
