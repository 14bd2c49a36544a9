// Parameters and effects as control charts: windows beside the healthy band, what changed since when, time until a limit.

import { draw, forget, series, tones } from "../charts/charts.js";
import { call, path } from "../lib/api.js";
import { h, notify, once, panel, show } from "../lib/dom.js";
import { inBrackets, moment, number, quantity, span } from "../lib/format.js";
import { runIn } from "../lib/jobs.js";
import { download } from "../lib/report_file.js";

const SAID = {
  steady: "steady",
  drift: "drifts slowly",
  "sudden-change": "changed suddenly",
  recovery: "recovered after a repair",
};
const SYMBOLS = { healthy: "circle", faulty: "triangle-up", "not-assessable": "diamond-open" };
const stamp = (seconds) => new Date(1000 * seconds);
const local = (seconds) => {
  const at = stamp(seconds);
  return new Date(at - at.getTimezoneOffset() * 60000).toISOString().slice(0, -1);
};

export function tracksPanel(asset) {
  const place = h("div", { class: "stack" });
  const leaving = [];
  const read = () =>
    runIn(
      place,
      "Following the parameters over all windows",
      path("assets", asset, "tracks"),
      {},
      (found) => drawItems(place, asset, found.items, read),
      leaving,
      { fresh: true },
    );
  const element = panel(
    "Parameters over the weeks",
    h("button", { type: "button", class: "quiet", "data-key": "follow-parameters", onclick: read }, "Follow them now"),
    place,
  );
  show(
    place,
    h(
      "p",
      { class: "muted" },
      "Each parameter and effect is shown beside its healthy band, with the time until a limit that you set.",
    ),
  );
  const leave = () => {
    for (const each of leaving) each();
    for (const chart of place.querySelectorAll(".chart")) forget(chart);
  };
  return { element, leave };
}

function drawItems(place, asset, items, read) {
  if (!items.length) return show(place, h("p", { class: "empty" }, "No window has told a parameter yet."));
  const limits = Object.fromEntries(items.filter((item) => item.limit !== null).map((item) => [item.parameter, item.limit]));
  const keep = async (name, text) => {
    if (text === "") delete limits[name];
    else limits[name] = Number(text);
    try {
      await call(path("assets", asset, "limits"), { method: "PUT", body: { limits } });
      await read();
    } catch (problem) {
      notify(problem.message);
    }
  };
  const parts = items.map((item) => {
    const chart = h("div", { class: "chart", role: "figure", "aria-label": `${item.parameter} over time` });
    const limit = h("input", {
      type: "number",
      step: "any",
      value: item.limit ?? "",
      "data-key": `limit-${item.parameter}`,
      placeholder: "none",
    });
    const set = once(() => keep(item.parameter, limit.value));
    const controls = h(
      "form",
      { class: "controls", onsubmit: set },
      h("label", {}, `limit${inBrackets(item.unit)}`, limit),
      h("button", { class: "quiet", "data-key": `set-${item.parameter}` }, "Set"),
      h(
        "button",
        { type: "button", class: "quiet", onclick: () => download(`${asset}-${item.parameter}.csv`, csv(item), "text/csv") },
        "CSV",
      ),
    );
    return [h("h3", {}, item.parameter), ...sentences(item).map((text) => h("p", {}, text)), controls, chart];
  });
  show(place, parts);
  for (const [index, item] of items.entries()) plot(parts[index].at(-1), item).catch((problem) => notify(problem.message));
  return undefined;
}

// What the track says, in words: what it does, since when, where it stands, and when it reaches its limit.
function sentences(item) {
  const { track, unit } = item;
  if (!track) return [`Not followed: ${item.reason}.`];
  const begun = track.kind === "steady" ? "" : ` since ${moment(stamp(track.since).toISOString())}`;
  const day = track.kind === "drift" ? `, by ${quantity(86400 * track.slope, unit)} a day` : "";
  const corrected = item.moves_with.length ? `, without what ${item.moves_with.join(" and ")} does to it` : "";
  const now = `now ${quantity(track.level, unit)} ± ${number(1.96 * track.level_std)}${corrected}`;
  const first = `It ${track.kind === "steady" ? "is steady" : SAID[track.kind]}${begun}${day}: ${now}.`;
  return track.remaining ? [first, untilLimit(track.remaining, unit)] : [first];
}

function untilLimit(left, unit) {
  const name = `The limit ${quantity(left.limit, unit)}`;
  if (left.says.startsWith("cannot")) return `${name}: ${left.says}.`;
  if (left.says) return `${name} is reached.`;
  const latest = left.high === null ? "later, if at all" : span(left.high);
  const middle = left.median === null ? "" : `in ${span(left.median)}, `;
  return `${name} will be reached ${middle}between ${span(left.low)} and ${latest} (${number(100 * left.confidence)} %).`;
}

function plot(place, item) {
  const colours = tones();
  const [blue, orange] = series();
  const x = item.time.map(local);
  const values = {
    type: "scatter",
    mode: "markers",
    x,
    y: item.value,
    error_y: { type: "data", array: item.std.map((std) => 1.96 * std), thickness: 1, width: 0 },
    marker: {
      size: 6,
      color: item.verdict.map((verdict) => colours[verdict]),
      symbol: item.verdict.map((verdict) => SYMBOLS[verdict]),
    },
    text: item.window.map((window, row) => `window ${window}: ${item.verdict[row]}`),
    hovertemplate: "%{text}<br>%{y:.5~g}<extra></extra>",
  };
  const { track } = item;
  const level = track
    ? [
        {
          type: "scatter",
          mode: "lines",
          x: track.time.map(local),
          y: track.corrected,
          line: { width: 1.5, color: blue },
          hovertemplate: "corrected %{y:.5~g}<extra></extra>",
        },
      ]
    : [];
  const band = item.healthy
    ? [
        {
          type: "rect",
          layer: "below",
          xref: "paper",
          x0: 0,
          x1: 1,
          y0: item.healthy.low,
          y1: item.healthy.high,
          fillcolor: colours.healthy,
          opacity: 0.15,
          line: { width: 0 },
        },
      ]
    : [];
  const line = (at, colour, dash) => ({ type: "line", line: { color: colour, dash, width: 1.5 }, ...at });
  const limit =
    item.limit === null ? [] : [line({ xref: "paper", x0: 0, x1: 1, y0: item.limit, y1: item.limit }, colours.faulty, "dash")];
  const events = (track?.events ?? []).map((event) =>
    line({ yref: "paper", y0: 0, y1: 1, x0: local(event.at), x1: local(event.at) }, orange, "dot"),
  );
  return draw(place, [...level, values], {
    x: { title: { text: "local time" }, type: "date" },
    y: { title: { text: `${item.parameter}${inBrackets(item.unit)}` }, exponentformat: "SI" },
    more: { shapes: [...band, ...limit, ...events] },
  });
}

const csv = (item) =>
  [
    "time,window,verdict,value,std",
    ...item.time.map((at, row) =>
      [stamp(at).toISOString(), item.window[row], item.verdict[row], item.value[row], item.std[row]].join(","),
    ),
  ].join("\n");
