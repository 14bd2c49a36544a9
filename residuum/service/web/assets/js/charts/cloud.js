// A missing term or residual against a signal: thinned points, mean with band, and curves of candidates over it.

import { h } from "../lib/dom.js";
import { effectTitle } from "../lib/effect_titles.js";
import { inBrackets } from "../lib/format.js";
import { draw, literal, series, tones } from "./charts.js";

// `onPoint(recordIndex, time)` is told the point that is clicked; `interval` = [from, to] of the axis is shaded.
export async function drawCloud(chart, view, of, axisName, { curves = [], interval = null, onPoint = null } = {}) {
  const axis = view.points.axes.find((each) => each.name === axisName);
  const term = view.points.terms.find((each) => each.of === of);
  if (!axis || !term) return;
  const [blue, orange, green, purple] = series();
  const mean = view.curves.find((each) => each.of === of && each.axis === axisName);
  const place = view.points.time.map((time, index) => [view.points.record[index], time]);
  const traces = [
    {
      type: "scatter",
      mode: "markers",
      name: "samples",
      x: axis.values,
      y: term.value,
      customdata: place,
      marker: { size: 4, color: blue, opacity: 0.28 },
      hovertemplate:
        `%{x:.4~g}${literal(inBrackets(axis.unit))}<br>%{y:.4~g}${literal(inBrackets(term.unit))}<br>at ` +
        `%{customdata[1]:.4~g} s<extra></extra>`,
    },
  ];
  if (mean?.at.length) {
    traces.push({
      type: "scatter",
      mode: "lines",
      x: [...mean.at, ...mean.at.toReversed()],
      y: [...mean.high, ...mean.low.toReversed()],
      fill: "toself",
      fillcolor: `${orange}38`,
      line: { width: 0 },
      name: "± 2 standard deviations",
      hoverinfo: "skip",
    });
    traces.push({
      type: "scatter",
      mode: "lines",
      x: mean.at,
      y: mean.mean,
      name: "mean",
      line: { color: orange, width: 2.2 },
      hovertemplate: "mean %{y:.4~g}<extra></extra>",
    });
  }
  const dashes = ["solid", "dash", "dot", "dashdot", "longdash"];
  for (const [index, curve] of curves.entries())
    traces.push({
      type: "scatter",
      mode: "lines",
      x: curve.at,
      y: curve.value,
      name: effectTitle(curve.effect),
      line: { color: [green, purple, tones().limit][index % 3], width: 2.4, dash: dashes[index % 5] },
      hovertemplate: "%{y:.4~g}<extra></extra>",
    });
  const shapes = interval
    ? [
        {
          type: "rect",
          xref: "x",
          yref: "paper",
          x0: interval[0],
          x1: interval[1],
          y0: 0,
          y1: 1,
          fillcolor: tones().faulty,
          opacity: 0.12,
          line: { width: 0 },
        },
      ]
    : [];
  await draw(chart, traces, {
    x: { title: { text: `${axis.name}${inBrackets(axis.unit)}` }, exponentformat: "SI" },
    y: {
      title: { text: `${term.kind === "balance" ? `what ${of} lacks` : `residual of ${of}`}${inBrackets(term.unit)}` },
      exponentformat: "SI",
    },
    more: {
      shapes,
      showlegend: true,
      legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 },
      margin: { l: 64, r: 12, t: 44, b: 42 },
    },
  });
  if (chart.removeAllListeners) {
    chart.removeAllListeners("plotly_click");
    if (onPoint)
      chart.on("plotly_click", ({ points }) => {
        if (points[0]?.customdata) onPoint(...points[0].customdata);
      });
  }
}

export const cloudChart = (label) => h("div", { class: "chart cloud", role: "figure", "aria-label": label });
