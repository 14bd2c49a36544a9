// Measured and simulated signals overlaid, the residual under them; zooming asks the server for more.

import { call, path } from "../lib/api.js";
import { h, notify } from "../lib/dom.js";
import { inBrackets } from "../lib/format.js";
import { draw, series, signalTraces } from "./charts.js";

// `models` = [{ record, label, dash }]: stored signals of a comparison each; `range` = [from, to] in seconds or null.
export function overlay(output, unit, models, { range = null, onRange = () => {} } = {}) {
  const chart = h("div", {
    class: "chart overlay",
    role: "figure",
    "aria-label": `${output}: measured and simulated, residual below`,
  });
  const shown = inBrackets(unit);
  const [measured, ...colours] = series();
  let asking = new AbortController();

  async function read(range) {
    asking.abort();
    asking = new AbortController();
    const cut = range ? `&from=${Math.max(0, range[0])}&to=${Math.max(range[1], 1e-9)}` : "";
    const channels = ["measured", "simulated", "residual"]
      .map((what) => `channel=${encodeURIComponent(`${output} ${what}`)}`)
      .join("&");
    const { signal } = asking;
    return Promise.all(models.map((model) => call(`${path("records", model.record, "signal")}?${channels}${cut}`, { signal })));
  }

  async function update(range) {
    try {
      const signals = await read(range);
      const traces = [...signalTraces(signals[0], `${output} measured`, measured, { name: "measured" })];
      signals.forEach((signal, index) => {
        const model = models[index];
        const line = { width: 1.3, color: colours[index], dash: model.dash };
        traces.push(...signalTraces(signal, `${output} simulated`, colours[index], { name: model.label, line }));
        traces.push(
          ...signalTraces(signal, `${output} residual`, colours[index], {
            name: `residual, ${model.label}`,
            yaxis: "y2",
            showlegend: false,
            line,
          }),
        );
      });
      await draw(chart, traces, {
        x: {
          title: { text: "time [s]" },
          exponentformat: "SI",
          anchor: "y2",
          ...(range ? { range, autorange: false } : { autorange: true }),
        },
        y: { title: { text: `${output}${shown}` }, exponentformat: "SI", domain: [0.38, 1] },
        y2: { title: { text: `residual${shown}` }, exponentformat: "SI", domain: [0, 0.3] },
        more: {
          showlegend: true,
          legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 },
          margin: { l: 64, r: 12, t: 34, b: 42 },
        },
        onZoom: (zoomed) => {
          onRange(zoomed);
          update(zoomed);
        },
      });
    } catch (problem) {
      if (problem.name !== "AbortError") notify(problem.message);
    }
  }

  queueMicrotask(() => update(range));
  return chart;
}
