// An indicator and its threshold over time; the verdict of every window by the marker's shape.

import { draw, forget, series, tones } from "../charts/charts.js";
import { call, path } from "../lib/api.js";
import { h, notify, show } from "../lib/dom.js";
import { inBrackets, title } from "../lib/format.js";
import { periods, since } from "../lib/periods.js";
import { plant } from "../lib/plant_state.js";

const KEPT = 500;
export const SYMBOLS = { healthy: "circle", faulty: "triangle-up", "not-assessable": "diamond-open" };

export function trendPanel(asset, told = () => {}) {
  const chart = h("div", { class: "chart", role: "img", "aria-label": "Indicator over time" });
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
      h("div", { class: "aside" }, "● healthy   ▲ faulty   ◇ not assessable   - - threshold"),
    ),
    h("div", { class: "body" }, empty, chart),
  );
  let history = null;
  let meanwhile = null; // findings that came during the newest reading

  async function read() {
    if (!plant.assets.has(asset)) return redraw();
    const came = [];
    meanwhile = came;
    const found = await call(`${path("assets", asset, "indicators")}?limit=${KEPT}${since(period.value)}`).catch(
      (problem) => notify(problem.message) ?? null,
    );
    if (came !== meanwhile) return undefined; // a later reading is under way
    meanwhile = null;
    history = found;
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
    plot(chart, history, select.value);
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

  read();
  return { element, add, read, leave: () => forget(chart) };
}

// The indicator that is now closest to its threshold, or furthest above it.
function closest(history, names) {
  const ratio = (name) => (history.indicators[name].at(-1) ?? 0) / (history.thresholds[name]?.at(-1) || Infinity);
  return names.reduce((best, name) => (ratio(name) > ratio(best) ? name : best));
}

function plot(chart, history, name) {
  const colours = tones();
  const unit = history.units[name] ?? "";
  const at = history.at.map((text) => new Date(text));
  const local = at.map((moment) => new Date(moment - moment.getTimezoneOffset() * 60000).toISOString().slice(0, -1));
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
  draw(chart, traces, {
    x: { title: { text: "local time" }, type: "date" },
    y: { title: { text: `${title(name)}${inBrackets(unit)}` }, rangemode: "tozero" },
  }).catch((error) => notify(error.message));
}
