// Ingest health: is every source there, how fast, and what was lost.

import { h } from "../lib/dom.js";
import { count, span, title } from "../lib/format.js";
import { badge } from "../lib/parts.js";
import { named } from "../lib/plant_state.js";
import { tableHead } from "../lib/table_head.js";

const HEADS = ["Source", "Quality", "Frames/s", "Samples/s", "Last seen", "Lost or refused"];

export function sourceTable(sources) {
  const rows = named(sources);
  if (!rows.length) return h("p", { class: "empty" }, "No bus is read. Windows can be sent over HTTP.");
  return h(
    "div",
    { class: "scroll" },
    h(
      "table",
      { class: "reflow" },
      tableHead(HEADS, [2, 3, 4]),
      h(
        "tbody",
        {},
        rows.map(([name, source]) => row(name, source)),
      ),
    ),
  );
}

function row(name, source) {
  return h(
    "tr",
    {},
    h("td", { "data-label": "Source" }, name),
    h("td", { "data-label": "Quality" }, badge(source.quality ?? "never-seen", losing(source))),
    h("td", { class: "number", "data-label": "Frames/s" }, count(source.frames_per_second)),
    h("td", { class: "number", "data-label": "Samples/s" }, count(source.samples_per_second)),
    h(
      "td",
      { class: "number", "data-label": "Last seen" },
      Number.isFinite(source.last_seen_seconds) ? `${span(source.last_seen_seconds)} ago` : "never",
    ),
    h(
      "td",
      { class: "wide", "data-label": "Lost or refused" },
      h(
        "div",
        {},
        losses(source.counters ?? {}),
        source.last_trouble ? h("div", { class: "muted small" }, source.last_trouble) : null,
        (source.remarks ?? []).map((remark) => h("div", { class: "small" }, remark)),
      ),
    ),
  );
}

// How many samples are missing of late, in the badge itself: a source that loses is not called good.
const losing = ({ quality, lost_lately: lost, lost_within_seconds: within }) =>
  quality === "losing" && lost > 0 ? `Lost ${count(lost)} in the last ${span(within)}` : undefined;

function losses(counters) {
  const found = Object.entries(counters)
    .filter(([, times]) => times > 0)
    .map(([name, times]) => `${count(times)} ${title(name)}`);
  return found.length ? found.join(", ") : "nothing";
}
