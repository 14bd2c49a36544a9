// An uploaded record, a strip a channel; zooming one asks the server for more of it.

import { call, path } from "../lib/api.js";
import { h, notify } from "../lib/dom.js";
import { inBrackets } from "../lib/format.js";
import { draw, signalTraces } from "./charts.js";

const AT_ONCE = 6; // channels that are drawn without being asked for
const POINTS = 1000;

function strip(record, name) {
  const chart = h("div", { class: "chart strip", role: "figure", "aria-label": `${name} of record ${record.id}` });
  let asking = new AbortController();

  async function update(range) {
    asking.abort();
    asking = new AbortController();
    const cut = range ? `&from=${Math.max(0, range[0])}&to=${Math.max(range[1], 1e-9)}` : "";
    const query = `channel=${encodeURIComponent(name)}&points=${POINTS}${cut}`;
    try {
      const signal = await call(`${path("records", record.id, "signal")}?${query}`, { signal: asking.signal });
      await draw(chart, signalTraces(signal, name), {
        x: { title: { text: "time [s]" }, exponentformat: "SI" },
        y: { title: { text: `${name.slice(0, 40)}${inBrackets(record.units[name])}` }, exponentformat: "SI", nticks: 5 },
        more: { uirevision: `${record.id} ${name}` },
        onZoom: update,
      });
    } catch (problem) {
      if (problem.name !== "AbortError") notify(problem.message);
    }
  }

  queueMicrotask(() => update(null));
  return chart;
}

// Strips of all channels; of many only the first, the others when they are asked for.
export function recordCharts(record) {
  const names = Object.keys(record.units);
  const later = names.slice(AT_ONCE);
  const more = h(
    "details",
    {
      ontoggle: () => {
        if (more.open) more.append(...later.splice(0).map((name) => strip(record, name)));
      },
    },
    h("summary", { "data-key": "more-channels" }, `${later.length} more channels`),
  );
  return h(
    "div",
    {},
    names.slice(0, AT_ONCE).map((name) => strip(record, name)),
    later.length ? more : null,
  );
}
