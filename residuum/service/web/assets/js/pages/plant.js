// The plant: all machines by state, alarms, ingest health.

import { h, panel, refresh, show } from "../lib/dom.js";
import { ago, assetTitle, moment } from "../lib/format.js";
import { badge, indicatorList, methodsLine, saidOf, sparkline, stateName, tone } from "../lib/parts.js";
import { named, plant, subscribe } from "../lib/plant_state.js";
import { alarmList } from "./alarms.js";
import { sourceTable } from "./sources.js";

const WORST_FIRST = ["faulty", "not-assessable", "no-baseline", "no-data", "healthy"];

export function plantPage(place) {
  const tally = h("div", { class: "tally" });
  const machines = h("div", { class: "machines" });
  const alarms = h("div");
  const sources = h("div");
  show(
    place,
    h("div", { class: "title" }, h("h1", {}, "Plant"), tally),
    machines,
    panel("Alarms", null, alarms),
    panel("Ingest", "every loss is counted", sources),
  );
  document.title = "Plant · Residuum";

  const draw = () => {
    show(tally, tallyOf());
    refresh(machines, cards);
    refresh(alarms, () => alarmList([...plant.alarms.values()].sort((a, b) => b.id - a.id)));
  };
  const drawSources = () => show(sources, sourceTable(plant.status.sources));
  const leave = subscribe((kind) => {
    if (kind !== "status") return draw();
    drawSources();
    return refresh(machines, cards);
  });
  const ticking = setInterval(draw, 5000);
  draw();
  drawSources();
  return () => {
    leave();
    clearInterval(ticking);
  };
}

function tallyOf() {
  const counts = Object.groupBy([...plant.assets.values()], (asset) => asset.state);
  return WORST_FIRST.filter((state) => counts[state]).map((state) =>
    badge(state, `${counts[state].length} ${stateName(state).toLowerCase()}`),
  );
}

function cards() {
  const training = new Map(named(plant.status.machines));
  const names = new Set([...plant.assets.keys(), ...training.keys()]);
  if (!names.size)
    return h(
      "p",
      { class: "empty" },
      "No machine is known yet. ",
      h("a", { href: "#/watch" }, "Watch a machine"),
      ", start the demo (",
      h("code", {}, "residuum serve --demo"),
      "), or send a window over HTTP. Without a machine at hand, ",
      h("a", { href: "#/workbench" }, "try the workbench's example"),
      ".",
    );
  return [...names]
    .map((name) => [
      plant.assets.get(name) ?? { id: name, title: name, state: "no-data", last_finding: null },
      training.get(name),
    ])
    .sort(([a], [b]) => (b.state === "faulty") - (a.state === "faulty") || a.id.localeCompare(b.id))
    .map(([asset, machine]) => card(asset, machine));
}

function card(asset, machine) {
  const finding = asset.last_finding;
  const busy = machine && machine.state === "training";
  const state = busy && !finding ? "training" : asset.state;
  return h(
    "article",
    { class: "panel machine", "data-tone": tone(state) },
    h(
      "header",
      {},
      h(
        "h3",
        {},
        h("a", { href: `#/machines/${encodeURIComponent(asset.id)}`, "data-key": `machine-${asset.id}` }, assetTitle(asset)),
      ),
      badge(state),
    ),
    busy ? progress(machine) : null,
    h(
      "p",
      { class: "says" },
      h(
        "span",
        { class: "clamp", title: saidOf(finding, machine) },
        busy && !finding ? "Learning what healthy looks like." : saidOf(finding, machine),
      ),
    ),
    methodsLine(finding),
    finding ? indicatorList(finding, 4) : null,
    finding ? sparkline((plant.trends.get(asset.id) ?? []).map((point) => point.ratio)) : null,
    h(
      "p",
      { class: "muted small" },
      finding ? h("span", { title: moment(finding.at) }, `window ${finding.window}, ${ago(finding.at)}`) : null,
    ),
  );
}

export function progress(machine) {
  const share = Math.round(100 * (machine.progress ?? 0));
  return h(
    "div",
    {},
    h(
      "div",
      {
        class: "progress",
        role: "progressbar",
        "aria-valuenow": share,
        "aria-valuemin": 0,
        "aria-valuemax": 100,
        "aria-label": "Training",
      },
      h("i", { style: { width: `${share}%` } }),
    ),
    h("p", { class: "muted small" }, `${share} % ${machine.text ?? machine.doing ?? ""}`),
  );
}
