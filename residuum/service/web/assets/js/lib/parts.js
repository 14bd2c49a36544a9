// Small parts that several pages show: badges, indicators against thresholds, sparklines.

import { h } from "./dom.js";
import { effectTitle } from "./effect_titles.js";
import { capital, localised, number, quantity, title, unitsIn } from "./format.js";
import { meaning } from "./indicator_meaning.js";

const STATES = {
  healthy: ["healthy", "Healthy"],
  faulty: ["faulty", "Faulty"],
  "not-assessable": ["unsure", "Not assessable"],
  "no-data": ["idle", "No data yet"],
  "no-baseline": ["idle", "Waiting for a baseline"],
  training: ["idle", "Training"],
  waiting: ["idle", "Waiting"],
  failed: ["faulty", "Failed"],
  unacknowledged: ["faulty", "Unacknowledged"],
  acknowledged: ["unsure", "Acknowledged"],
  "returned-unacknowledged": ["unsure", "Returned, unacknowledged"],
  shelved: ["idle", "Shelved"],
  suppressed: ["idle", "Suppressed"],
  normal: ["healthy", "Normal"],
  good: ["healthy", "Good"],
  uncounted: ["unsure", "No counter: losses cannot be seen"],
  doubtful: ["unsure", "Values look wrong"],
  stale: ["faulty", "Stale"],
  losing: ["unsure", "Loses samples"],
  "never-seen": ["idle", "Never seen"],
};
// A shape each, so that no meaning rests on colour alone.
const SHAPES = {
  healthy: ["M8 1a7 7 0 1 0 0 14A7 7 0 0 0 8 1Z", "M4.8 8.2l2.2 2.2 4.2-4.6"],
  faulty: ["M8 1l7 13.500H1Z", "M8 6v4M8 12v.01"],
  unsure: ["M8 .8l7.200 7.200L8 15.200.8 8Z", "M6.300 6.400a1.700 1.700 0 1 1 2.300 1.600q-.6.300-.6 1M8 11.300v.01"],
  idle: ["M3 2h10a1 1 0 0 1 1 1v10a1 1 0 0 1-1 1H3a1 1 0 0 1-1-1V3a1 1 0 0 1 1-1Z", "M5 8h6"],
};

export const tone = (state) => (STATES[state] ?? ["idle"])[0];
export const stateName = (state) => (STATES[state] ?? ["idle", title(String(state))])[1];

export function icon(state) {
  const [outline, sign] = SHAPES[tone(state)];
  return h(
    "svg:svg",
    { viewBox: "0 0 16 16", "aria-hidden": "true" },
    h("svg:path", { d: outline, fill: "none", stroke: "currentColor", "stroke-width": "1.500" }),
    h("svg:path", {
      d: sign,
      fill: "none",
      stroke: "currentColor",
      "stroke-width": "1.700",
      "stroke-linecap": "round",
      "stroke-linejoin": "round",
    }),
  );
}

// The state that a finding shows: its verdict, or that there was nothing to judge by.
export const stateOf = (finding) => (finding.evidence?.recorded_without_baseline ? "no-baseline" : finding.verdict);

export const badge = (state, text) =>
  h("span", { class: "badge", "data-tone": tone(state) }, icon(state), text ?? stateName(state));

// Indicators with their thresholds, the closest to (or furthest above) its threshold first.
export function ranked(finding) {
  const rows = Object.entries(finding?.indicators ?? {}).map(([name, value]) => {
    const threshold = finding.thresholds[name];
    const ratio = Number.isFinite(value) && Number.isFinite(threshold) && threshold > 0 ? value / threshold : null;
    const above = Number.isFinite(value) && Number.isFinite(threshold) && value > threshold;
    return { name, value, threshold, ratio, above, unit: finding.units?.[name] ?? "" };
  });
  return rows.sort((a, b) => b.above - a.above || (b.ratio ?? -1) - (a.ratio ?? -1));
}

export function meter(row) {
  if (row.ratio === null) return null;
  const bar = h("i", { style: { width: `${Math.min(100, Math.max(1, row.ratio * 50))}%` } });
  const label = `${title(row.name)}: ${number(row.ratio)} times its threshold`;
  return h("span", { class: "meter", role: "img", "aria-label": label, "data-above": row.above }, bar, h("b"));
}

export function indicatorList(finding, most) {
  const rows = ranked(finding).slice(0, most);
  return h(
    "div",
    { class: "indicators" },
    rows.map((row) =>
      h(
        "div",
        { class: "indicator" },
        h("span", { class: "name", title: meaning(row.name) }, title(row.name)),
        h(
          "span",
          { class: "number" },
          h("span", { class: row.above ? "above" : "" }, quantity(row.value, row.unit, row.threshold)),
          !Number.isFinite(row.threshold)
            ? null
            : h("span", { class: "muted" }, row.above ? " above " : " of ", quantity(row.threshold, row.unit, row.value)),
        ),
        meter(row),
      ),
    ),
  );
}

// The largest ratio of indicator to threshold over time; the dashed line is the threshold.
export function sparkline(ratios) {
  if (ratios.length < 2) return h("p", { class: "muted small" }, "The trend appears after two windows.");
  const top = Math.max(1.3, ...ratios.filter(Number.isFinite)) * 1.05;
  const x = (index) => ((index / (ratios.length - 1)) * 300).toFixed(1);
  const y = (ratio) => (42 - (Math.min(ratio, top) / top) * 40).toFixed(1);
  const line = (keep) =>
    ratios.map((ratio, index) => (Number.isFinite(ratio) && keep(ratio, index) ? `${x(index)},${y(ratio)}` : "|")).join(" ");
  const strokes = (kind, points) =>
    points
      .split("|")
      .map((part) => part.trim())
      .filter(Boolean)
      .map((part) => h("svg:polyline", { class: kind, points: part.includes(" ") ? part : `${part} ${part}` }));
  const last = ratios.findLast(Number.isFinite);
  return h(
    "svg:svg",
    {
      class: "spark",
      viewBox: "0 0 300 44",
      preserveAspectRatio: "none",
      role: "img",
      "aria-label": `Trend of the last ${ratios.length} windows: now ${number(last)} times the threshold`,
    },
    h("svg:line", { class: "limit", x1: 0, x2: 300, y1: y(1), y2: y(1) }),
    strokes(
      "line",
      line(() => true),
    ),
    strokes(
      "above",
      line((ratio) => ratio > 1),
    ),
  );
}

// What each method of a diagnoser with two says of a window, the one that decides marked; nothing for any other finding.
export function methodsSay(finding) {
  const { method, source_method: source, default_method: ours } = finding?.evidence ?? {};
  if (!source || !ours) return [];
  const result = (one) => (one.class ? effectTitle(one.class) : one.verdict ? stateName(one.verdict) : (one.reason ?? "–"));
  return [
    { id: "default", name: "Default method", says: result(ours), decides: method === "default", reason: ours.reason },
    { id: "source", name: "Source's method", says: result(source), decides: method === "source", reason: source.reason },
  ];
}

// The same as one line.
export function methodsLine(finding) {
  const said = methodsSay(finding).map(({ name, says, decides }) => `${name}: ${says}${decides ? " (decides)" : ""}`);
  return said.length ? h("p", { class: "muted small methods" }, said.join(" · ")) : null;
}

export const worst = (finding) => ranked(finding)[0]?.ratio ?? null;

// An effect at its place in words, where a parameter's full name does not go on after it.
export const placed = (text) =>
  text.replaceAll(/\b([a-z]+(?:-[a-z]+)*)@([\w-]+)\b(?!\.\w)/g, (_, effect, place) => `${effectTitle(effect)} of the ${place}`);

// A sentence that begins with a parameter's name, which keeps its letters: `k 1.2 N·m, healthy …` is not said of a `K`.
const NAMES_A_PARAMETER = /^\w+(?= -?\d|, of a size )|^[b-z]\b/;

// A line that the service wrote as a sentence: an indicator's name in words, decimals of the browser's language, a capital, a
// full stop.
export function said(line) {
  const begun = NAMES_A_PARAMETER.test(line) ? line : capital(line.replace(/^[a-z0-9]+(?:_[a-z0-9]+)+/, title));
  const text = unitsIn(placed(localised(begun)));
  return `${text}${/[.!?…]$/.test(text) ? "" : "."}`;
}

// What is said of a machine: why it failed, its finding, or how it comes to a baseline.
export function saidOf(finding, machine) {
  if (machine?.state === "failed") return said(machine.doing);
  const unjudged = !finding || stateOf(finding) === "no-baseline";
  return unjudged && machine?.state === "recording" ? said(machine.doing) : sentence(finding);
}

export function sentence(finding) {
  if (!finding) return "Waiting for the first window.";
  if (finding.reason) return said(finding.reason);
  const closest = ranked(finding)[0];
  const what = finding.class ? `${capital(effectTitle(finding.class))} found` : stateName(finding.verdict);
  if (!closest || closest.ratio === null) return `${what}.`;
  return (
    `${what}: ${title(closest.name)} is ${quantity(closest.value, closest.unit)}, ${number(closest.ratio)} times ` +
    `its threshold.`
  );
}
