// The plant: all machines by state, alarms, ingest health.

import { h, panel, refresh, show } from "../lib/dom.js";
import { ago, assetTitle, capital, count, moment } from "../lib/format.js";
import { badge, indicatorList, methodsLine, said, saidOf, sparkline, stateName, tone } from "../lib/parts.js";
import { isLive, machinesOfPlant, plant, shownState, subscribe } from "../lib/plant_state.js";
import { alarmList } from "./alarms.js";
import { sourceTable } from "./sources.js";

const WORST_FIRST = ["failed", "faulty", "not-assessable", "no-baseline", "training", "no-data", "healthy"];

export function plantPage(place) {
  const tally = h("div", { class: "tally" });
  const machines = h("div", { class: "machines" });
  const alarms = h("div");
  const sources = h("div");
  show(
    place,
    h("div", { class: "title" }, h("h1", {}, "Plant"), tally),
    machines,
    panel("Alarms", h("a", { href: "#/alarms" }, "History"), alarms),
    panel("Ingest", "every loss is counted", sources),
  );
  document.title = "Plant · Residuum";

  const draw = () => {
    show(tally, tallyOf());
    refresh(machines, cards);
    refresh(alarms, () => alarmList([...plant.alarms.values()]));
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
  const counts = Object.groupBy(machinesOfPlant(), ([asset, machine]) => shownState(asset, machine));
  return WORST_FIRST.filter((state) => counts[state]).map((state) =>
    badge(state, `${counts[state].length} ${stateName(state).toLowerCase()}`),
  );
}

function cards() {
  const machines = machinesOfPlant();
  if (!machines.length)
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
  const bad = ([asset, machine]) => ["failed", "faulty"].includes(shownState(asset, machine));
  return machines.sort((a, b) => bad(b) - bad(a)).map(([asset, machine]) => card(asset, machine));
}

function card(asset, machine) {
  const finding = asset.last_finding;
  const busy = machine && machine.state === "training";
  const state = shownState(asset, machine);
  return h(
    "article",
    { class: "panel machine", "data-tone": tone(state) },
    h(
      "header",
      {},
      h(
        "h2",
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
    wayOn(asset.id, machine),
    methodsLine(finding),
    finding ? indicatorList(finding, 4) : null,
    finding ? sparkline((plant.trends.get(asset.id) ?? []).map((point) => point.ratio)) : null,
    h("p", { class: "muted small" }, freshness(asset, machine)),
  );
}

// When the last window was judged, and whether windows are being judged now.
export function freshness(asset, machine) {
  const finding = asset?.last_finding;
  if (!finding) return null;
  const live = isLive(asset, machine);
  const told = h("span", { title: moment(finding.at) }, `window ${finding.window}, ${ago(finding.at)}`);
  return [live ? h("span", { class: "live" }, "live") : null, told];
}

// What keeps windows from being judged, and how the machine comes to work again.
export function wayOn(name, machine) {
  const { state, doing, way_on: way, scoring_errors: errors, simulated } = machine ?? {};
  const lines = [];
  if (state === "waiting") lines.push(said(doing));
  if (state === "failed" || way) lines.push(capital(`${way || "the service's log says more"}.`));
  if (errors && state !== "failed")
    lines.push(`${count(errors)} ${errors === 1 ? "window" : "windows"} could not be judged; the service's log says more.`);
  if (!lines.length) return null;
  const change = state === "failed" && !simulated;
  return h(
    "p",
    { class: state === "failed" || way || errors ? "above" : "muted small" },
    lines.join(" "),
    change ? [" ", h("a", { href: `#/watch?machine=${encodeURIComponent(name)}` }, "Change it or train it again")] : null,
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
