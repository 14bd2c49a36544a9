// Step 2: what the signals read now, with the last half minute of each.

import { call } from "../lib/api.js";
import { h, panel, show } from "../lib/dom.js";
import { quantity } from "../lib/format.js";
import { plant } from "../lib/plant_state.js";
import { tableHead } from "../lib/table_head.js";

const HEADS = ["Signal", "Now", "Last half minute"];

export async function signalsStep(place, way) {
  const table = h("div");
  const state = h("p", { class: "muted" });
  const next = h(
    "button",
    { type: "button", "data-key": "next", disabled: true, onclick: () => way.go("healthy") },
    "These values are right",
  );
  show(place, panel("Live values", null, state, table, h("p", { class: "next" }, next)));
  await way.every(1000, async () => {
    const { signals } = await call(way.address("live"));
    const rows = Object.entries(signals);
    next.disabled = !rows.length;
    state.textContent = rows.length ? lacking(way.machine, rows) : waiting(way);
    show(table, rows.length ? tableOf(rows) : null);
  });
}

// What the machine's sources say is wrong.
const trouble = (machine) =>
  Object.values(plant.status.sources ?? {})
    .filter((source) => source.machine === machine)
    .map((source) => source.last_trouble)
    .find(Boolean);

// Why nothing has come.
function waiting({ machine, settings }) {
  const [{ channel, host, port }] = settings.sources;
  const address = channel || `${host}:${port}`;
  const why = trouble(machine);
  return (
    `Nothing has come yet from ${address}${why ? `: ${why}` : ""}. ` +
    "Is the machine on, and is the address right? It is changed under Source."
  );
}

// Which signals have no value, and why.
function lacking(machine, rows) {
  const names = rows.filter(([, signal]) => !Number.isFinite(signal.value)).map(([bus]) => bus);
  if (!names.length) return "Compare them with what the machine shows.";
  const why = trouble(machine);
  return `No value for ${names.join(", ")}${why ? `: ${why}` : ""}. The description is changed under Source.`;
}

function tableOf(rows) {
  const row = ([bus, signal]) =>
    h(
      "tr",
      {},
      h(
        "td",
        { "data-label": HEADS[0] },
        bus,
        signal.name === bus ? null : h("span", { class: "muted" }, ` (the model's ${signal.name})`),
      ),
      h("td", { "data-label": HEADS[1], class: "number" }, quantity(signal.value, signal.unit)),
      h("td", { "data-label": HEADS[2] }, sparkline(signal.history)),
    );
  return h("div", { class: "scroll" }, h("table", { class: "reflow" }, tableHead(HEADS, [1]), h("tbody", {}, rows.map(row))));
}

function sparkline({ seconds, values }) {
  const known = values.filter(Number.isFinite);
  const [low, high] = [Math.min(...known), Math.max(...known)];
  const x = (at) => 300 + at * 10;
  const y = (value) => 40 - (36 * (value - low)) / (high - low || 1);
  const points = values.flatMap((value, index) =>
    Number.isFinite(value) ? [`${x(seconds[index]).toFixed(1)},${y(value).toFixed(1)}`] : [],
  );
  return h(
    "svg:svg",
    { class: "spark", viewBox: "0 0 300 44", preserveAspectRatio: "none", "aria-hidden": "true" },
    h("svg:polyline", { class: "line", points: points.join(" ") }),
  );
}
