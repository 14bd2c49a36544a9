// An indicator and its threshold over time, the verdict of every window by the marker's shape; below it, on the same axis, what
// became of the machine.

import { draw, forget, series, tones } from "../charts/charts.js";
import { call, path } from "../lib/api.js";
import { h, notify, show } from "../lib/dom.js";
import { inBrackets, title } from "../lib/format.js";
import { periods, since } from "../lib/periods.js";
import { plant } from "../lib/plant_state.js";
import { lanes, NOTHING, readLife } from "./life.js";

const KEPT = 500;
export const SYMBOLS = { healthy: "circle", faulty: "triangle-up", "not-assessable": "diamond-open" };

export function trendPanel(asset, told = () => {}) {
  const chart = h("div", { class: "chart", role: "figure", "aria-label": "Indicator over time" });
  const select = h("select", { "aria-label": "Indicator", "data-key": "trend-indicator", onchange: () => redraw() });
  const period = h(
    "select",
    { "aria-label": "Period", "data-key": "trend-period", onchange: () => read() },
    periods(`last ${KEPT} windows`).map(([value, text]) => h("option", { value }, text)),
  );
  const empty = h("p", { class: "empty" });
  const element = h(
    "section",
    { class: "panel" },
    h(
      "header",
      {},
      h("h2", {}, "Trend"),
      h("div", { class: "controls" }, select, period),
      h("div", { class: "aside" }, "● healthy   ▲ faulty   ◇ not assessable   - - threshold   ▬ alarm   ■ model"),
    ),
    h("div", { class: "body" }, empty, chart),
  );
  let history = null;
  let life = NOTHING;
  let meanwhile = null; // findings that came during the newest reading

  async function read() {
    if (!plant.assets.has(asset)) return redraw();
    const came = [];
    meanwhile = came;
    const [found, lived] = await Promise.all([
      call(`${path("assets", asset, "indicators")}?limit=${KEPT}${since(period.value)}`).catch(
        (problem) => notify(problem.message) ?? null,
      ),
      readLife(asset, since(period.value)),
    ]);
    if (came !== meanwhile) return undefined; // a later reading is under way
    meanwhile = null;
    history = found;
    life = lived;
    if (history) came.filter((finding) => !history.windows.includes(finding.window)).forEach(append);
    return redraw();
  }

  function redraw() {
    const names = history ? Object.keys(history.indicators) : [];
    empty.textContent = names.length ? "" : period.value ? "No window was judged in this period." : "No indicator yet.";
    chart.hidden = !names.length;
    select.hidden = names.length < 2;
    if (!names.length) return;
    if (names.join() !== [...select.options].map((option) => option.value).join()) {
      const before = select.value;
      show(
        select,
        names.map((name) => h("option", { value: name }, title(name))),
      );
      select.value = names.includes(before) ? before : closest(history, names);
    }
    plot(chart, history, life, select.value);
    told(history);
  }

  function add(finding) {
    meanwhile?.push(finding);
    if (!history) return meanwhile ? undefined : read();
    append(finding);
    return redraw();
  }

  function append(finding) {
    for (const [table, now] of [
      [history.indicators, finding.indicators],
      [history.thresholds, finding.thresholds],
    ]) {
      for (const name of new Set([...Object.keys(table), ...Object.keys(now)])) {
        table[name] ??= history.at.map(() => null);
        table[name].push(now[name] ?? null);
      }
    }
    history.at.push(finding.at);
    history.verdicts.push(finding.verdict);
    history.windows.push(finding.window);
    Object.assign(history.units, finding.units);
  }

  // An alarm or a confirmation: only what became of the machine is read anew.
  async function live() {
    if (!plant.assets.has(asset)) return;
    const lived = await readLife(asset, since(period.value));
    if (!chart.isConnected) return;
    life = lived;
    redraw();
  }

  read();
  return { element, add, read, live, leave: () => forget(chart) };
}

// The indicator that is now closest to its threshold, or furthest above it.
function closest(history, names) {
  const ratio = (name) => (history.indicators[name].at(-1) ?? 0) / (history.thresholds[name]?.at(-1) || Infinity);
  return names.reduce((best, name) => (ratio(name) > ratio(best) ? name : best));
}

// Plotly draws dates as they are written: those of this place are written for it.
function localTime(text) {
  const moment = new Date(text);
  return new Date(moment - moment.getTimezoneOffset() * 60000).toISOString().slice(0, -1);
}

function plot(chart, history, life, name) {
  const colours = tones();
  const unit = history.units[name] ?? "";
  const local = history.at.map(localTime);
  // Of all windows only what lies beside them: one alarm of last year would press them into a line.
  const from = local[0] ?? "";
  const beside = {
    alarms: life.alarms.filter(({ cleared_at: gone }) => !gone || localTime(gone) >= from),
    found: life.found.filter(({ found_at: at }) => localTime(at) >= from),
    models: life.models.filter(({ created_at: at }) => localTime(at) >= from),
  };
  const below = lanes(beside, (text) => (localTime(text) < from ? from : localTime(text)));
  const traces = [
    {
      type: "scatter",
      mode: "lines+markers",
      x: local,
      y: history.indicators[name],
      connectgaps: false,
      line: { width: 1, color: series()[0] },
      marker: {
        size: 7,
        symbol: history.verdicts.map((verdict) => SYMBOLS[verdict]),
        color: history.verdicts.map((verdict) => colours[verdict]),
      },
      text: history.verdicts.map((verdict, row) => `window ${history.windows[row]}: ${verdict}`),
      hovertemplate: "%{text}<br>%{y:.4~g}<extra></extra>",
    },
  ];
  if (history.thresholds[name]) {
    traces.push({
      type: "scatter",
      mode: "lines",
      x: local,
      y: history.thresholds[name],
      line: { dash: "dash", width: 1.5, color: colours.limit, shape: "hv" },
      hovertemplate: "threshold %{y:.4~g}<extra></extra>",
    });
  }
  const share = below.titles.length ? 0.08 * below.titles.length + 0.06 : 0; // of the height, for the lanes
  draw(chart, [...traces, ...below.traces], {
    x: { title: { text: "local time" }, type: "date", ...(share ? { anchor: "y2" } : {}) },
    y: { title: { text: `${title(name)}${inBrackets(unit)}` }, rangemode: "tozero", domain: [share, 1] },
    y2: share
      ? {
          type: "category",
          categoryarray: below.titles.toReversed(),
          domain: [0, share - 0.04],
          fixedrange: true,
          zeroline: false,
        }
      : null,
  }).catch((error) => notify(error.message));
}
