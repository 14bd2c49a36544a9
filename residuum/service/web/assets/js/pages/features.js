// Two indicators against each other with the regions that a trained classifier or their thresholds make, and boxes by quadrant.

import { draw, forget, series, tones } from "../charts/charts.js";
import { call, path } from "../lib/api.js";
import { h, notify, show } from "../lib/dom.js";
import { inBrackets, title } from "../lib/format.js";
import { hasView } from "../lib/plant_state.js";
import { SYMBOLS } from "./trend.js";

const QUADRANT = /^(.+)_q(\d+)$/;

const FIRST_PLANE = ["F1", "F2"];
const WIDEST = 8;

// `update(history)` is told the indicators of the newest windows.
export function featurePanels(asset) {
  const plane = h("div", { class: "chart tall", role: "figure", "aria-label": "Feature plane" });
  const boxes = h("div", { class: "chart tall", role: "figure", "aria-label": "Quadrant boxes" });
  const across = h("select", { "aria-label": "Indicator across", "data-key": "plane-x", onchange: () => redraw() });
  const up = h("select", { "aria-label": "Indicator up", "data-key": "plane-y", onchange: () => redraw() });
  const of = h("select", { "aria-label": "Indicator of the boxes", "data-key": "boxes-of", onchange: () => redraw() });
  const element = h("div", { class: "columns", hidden: true });
  const about = h("div", { class: "aside" });
  const planePart = h(
    "section",
    { class: "panel span-6" },
    h(
      "header",
      {},
      h("h2", {}, "Feature plane"),
      h("div", { class: "controls" }, across, h("span", { class: "muted" }, "and"), up),
      about,
    ),
    h("div", { class: "body" }, plane),
  );
  const boxPart = h(
    "section",
    { class: "panel span-6" },
    h(
      "header",
      {},
      h("h2", {}, "By quadrant"),
      h("div", { class: "controls" }, of),
      h("div", { class: "aside" }, "◆ the last window"),
    ),
    h("div", { class: "body" }, boxes),
  );
  let history = null;
  let classified = []; // features that the classifier's planes can be made of
  let classifier = null; // the question for them, asked once
  let asking = new AbortController();

  // Nothing is drawn before the classifier's features are known: they are the first choice of what is shown.
  async function update(newest) {
    history = newest;
    classifier ??= hasView(asset, "decision-regions")
      ? regions({}, history.windows.at(-1)).catch(() => {
          classifier = null;
        })
      : Promise.resolve();
    classified = (await classifier)?.features ?? [];
    redraw();
  }

  const regions = (query, window, signal) =>
    call(`${path("assets", asset, "windows", window, "decision-regions")}?${new URLSearchParams(query)}`, { signal });

  // The plane over all windows, or as much wider as it takes until a second region comes into sight.
  async function widened(x, y, window, signal) {
    for (let factor = 1; ; factor *= 2) {
      const found = await regions({ x, y, x_to: factor * extent(history, x), y_to: factor * extent(history, y) }, window, signal);
      if (factor === WIDEST || new Set(found.region.flat()).size > 1) return found;
    }
  }

  // Regions of the trained classifier when it has any for these two features, else the half planes beyond the thresholds.
  async function plotPlane(x, y) {
    asking.abort();
    asking = new AbortController();
    const { signal } = asking;
    const last = lastWith(history, x, y);
    const cut = classified.includes(x) && classified.includes(y) && x !== y && last !== null;
    const found = cut ? await widened(x, y, history.windows[last], signal) : null;
    signal.throwIfAborted();
    about.textContent = !found
      ? "shaded: beyond a threshold"
      : FIRST_PLANE.includes(x) && FIRST_PLANE.includes(y)
        ? "regions of the trained classifier, dashed: alarm limits"
        : "cut through the classifier's regions at the last movement, dashed: alarm limits";
    await drawPlane(plane, history, x, y, found, last);
  }

  function redraw() {
    const names = history ? Object.keys(history.indicators).filter((name) => history.indicators[name].some(Number.isFinite)) : [];
    const quadrants = [...new Set(names.map((name) => QUADRANT.exec(name)?.[1]).filter(Boolean))];
    element.hidden = names.length < 2;
    if (element.hidden) return;
    const plain = names.filter((name) => !QUADRANT.test(name));
    const judged = plain.filter((name) => history.thresholds[name]?.some(Number.isFinite));
    const first = FIRST_PLANE.every((name) => classified.includes(name)) ? FIRST_PLANE : judged;
    offer(across, names, first[0] ?? plain[0] ?? names[0]);
    offer(up, names, first[1] ?? plain.find((name) => name !== across.value) ?? names[1]);
    offer(of, quadrants, quadrants[0]);
    if (element.childElementCount !== (quadrants.length ? 2 : 1)) {
      planePart.className = `panel ${quadrants.length ? "span-6" : "span-12"}`;
      element.replaceChildren(planePart, ...(quadrants.length ? [boxPart] : []));
    }
    plotPlane(across.value, up.value).catch((error) => {
      if (error.name !== "AbortError") notify(error.message);
    });
    if (quadrants.length) drawBoxes(boxes, history, of.value).catch((error) => notify(error.message));
  }

  return {
    element,
    update,
    leave: () => {
      asking.abort();
      forget(plane);
      forget(boxes);
    },
  };
}

function offer(select, names, first) {
  if (names.join() === [...select.options].map((option) => option.value).join()) return;
  const before = select.value;
  show(
    select,
    names.map((name) => h("option", { value: name }, title(name))),
  );
  select.value = names.includes(before) ? before : first;
}

const newestThreshold = (history, name) => history.thresholds[name]?.findLast(Number.isFinite);
const axisTitle = (history, name) => ({ text: `${title(name)}${inBrackets(history.units[name])}` });

const extent = (history, name) =>
  1.1 * Math.max(newestThreshold(history, name) ?? 0, ...history.indicators[name].filter(Number.isFinite));
const lastWith = (history, ...names) => {
  const row = history.windows.findLastIndex((_, index) =>
    names.every((name) => Number.isFinite(history.indicators[name][index])),
  );
  return row < 0 ? null : row;
};

// What lies beyond a threshold is judged faulty: those half planes are shaded, unless a classifier's regions are drawn.
function drawPlane(place, history, x, y, found, last) {
  const colours = tones();
  const limits = [
    [x, "x"],
    [y, "y"],
  ]
    .map(([name, axis]) => [axis, newestThreshold(history, name), extent(history, name)])
    .filter(([, limit]) => Number.isFinite(limit));
  const other = { x: "y", y: "x" };
  const beyond = ([axis, limit, end]) => ({
    type: "rect",
    layer: "below",
    fillcolor: colours.faulty,
    opacity: 0.1,
    line: { width: 0 },
    [`${axis}0`]: limit,
    [`${axis}1`]: Math.max(end, 1.2 * limit),
    [`${other[axis]}ref`]: "paper",
    [`${other[axis]}0`]: 0,
    [`${other[axis]}1`]: 1,
  });
  const at = ([axis, limit]) => ({
    type: "line",
    line: { dash: "dash", width: 1.2, color: colours.limit },
    [`${axis}0`]: limit,
    [`${axis}1`]: limit,
    [`${other[axis]}ref`]: "paper",
    [`${other[axis]}0`]: 0,
    [`${other[axis]}1`]: 1,
  });
  const windows = Object.entries(SYMBOLS)
    .map(([verdict, symbol]) => {
      const rows = history.verdicts.flatMap((each, row) => (each === verdict ? [row] : []));
      return {
        type: "scatter",
        mode: "markers",
        name: verdict.replace("-", " "),
        x: rows.map((row) => history.indicators[x][row]),
        y: rows.map((row) => history.indicators[y][row]),
        text: rows.map((row) => `window ${history.windows[row]}`),
        marker: { size: 8, symbol, color: colours[verdict], opacity: 0.75 },
        hovertemplate: "%{text}<br>%{x:.4~g}<br>%{y:.4~g}<extra></extra>",
      };
    })
    .filter((trace) => trace.x.length);
  const now =
    last === null
      ? []
      : [
          {
            type: "scatter",
            mode: "markers",
            name: "last window",
            x: [history.indicators[x][last]],
            y: [history.indicators[y][last]],
            marker: {
              size: 15,
              symbol: "star",
              color: colours[history.verdicts[last]],
              line: { width: 1.5, color: colours.limit },
            },
            hovertemplate: `window ${history.windows[last]}<br>%{x:.4~g}<br>%{y:.4~g}<extra></extra>`,
          },
        ];
  const whole = (grid) => (found ? { range: [0, grid.at(-1)] } : {});
  return draw(place, [...(found ? regionTraces(found) : []), ...windows, ...now], {
    x: { title: axisTitle(history, x), exponentformat: "SI", ...whole(found?.x) },
    y: { title: axisTitle(history, y), exponentformat: "SI", ...whole(found?.y) },
    more: {
      shapes: limits.map(found ? at : beyond),
      annotations: found ? regionNames(found) : [],
      barmode: "overlay",
      bargap: 0,
      showlegend: true,
      legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 },
      margin: { l: 64, r: 12, t: 34, b: 42 },
    },
  });
}

const shades = () => {
  const [blue, orange, green, purple] = series();
  return { healthy: green, "pinion-or-gear": orange, rack: purple, unknown: blue };
};

// Runs of one class along each row as bars. (Plotly's heat map would need inline styles, which the page's policy forbids.)
function regionTraces({ x, y, classes, region }) {
  const [across, up] = [x[1] - x[0], y[1] - y[0]];
  const runs = classes.map(() => []);
  region.forEach((row, index) => {
    let begin = 0;
    row.forEach((each, at) => {
      if (at + 1 < row.length && row[at + 1] === each) return;
      runs[each].push({ y: y[index], base: x[begin] - across / 2, length: (at + 1 - begin) * across });
      begin = at + 1;
    });
  });
  return classes.flatMap((name, index) =>
    runs[index].length
      ? [
          {
            type: "bar",
            orientation: "h",
            y: runs[index].map((run) => run.y),
            base: runs[index].map((run) => run.base),
            x: runs[index].map((run) => run.length),
            width: up,
            marker: { color: shades()[name] ?? series()[0], opacity: 0.22, line: { width: 0 } },
            hoverinfo: "skip",
            showlegend: false,
          },
        ]
      : [],
  );
}

// Each region's name where the class is thickest: at the cell nearest to the middle of all its cells.
function regionNames({ x, y, classes, region }) {
  return classes.flatMap((name, index) => {
    const cells = region.flatMap((row, up) => row.flatMap((each, across) => (each === index ? [[across, up]] : [])));
    if (cells.length < 0.01 * x.length * y.length) return [];
    const middle = [0, 1].map((axis) => cells.reduce((sum, cell) => sum + cell[axis], 0) / cells.length);
    const [across, up] = cells.reduce((best, cell) =>
      Math.hypot(cell[0] - middle[0], cell[1] - middle[1]) < Math.hypot(best[0] - middle[0], best[1] - middle[1]) ? cell : best,
    );
    return [
      { x: x[across], y: y[up], text: title(name), showarrow: false, font: { size: 13 }, bgcolor: "rgba(128, 128, 128, 0.12)" },
    ];
  });
}

function drawBoxes(place, history, of) {
  const [blue] = series();
  const colours = tones();
  const names = Object.keys(history.indicators)
    .filter((name) => QUADRANT.exec(name)?.[1] === of)
    .sort();
  const labels = names.map((name) => `quadrant ${QUADRANT.exec(name)[2]}`);
  const boxes = names.map((name, index) => ({
    type: "box",
    name: labels[index],
    y: history.indicators[name].filter(Number.isFinite),
    boxpoints: "outliers",
    line: { color: blue, width: 1.4 },
    marker: { size: 4, color: blue },
    fillcolor: `${blue}30`,
    showlegend: false,
  }));
  const last = {
    type: "scatter",
    mode: "markers",
    name: "last window",
    x: labels,
    y: names.map((name) => history.indicators[name].at(-1)),
    marker: { symbol: "diamond", size: 10, color: colours[history.verdicts.at(-1)] },
    hovertemplate: "%{y:.4~g}<extra>last window</extra>",
  };
  const limits = {
    type: "scatter",
    mode: "markers",
    name: "threshold",
    x: labels,
    y: names.map((name) => newestThreshold(history, name) ?? null),
    marker: { symbol: "line-ew", size: 46, line: { width: 2, color: colours.limit } },
    hovertemplate: "threshold %{y:.4~g}<extra></extra>",
  };
  return draw(place, [...boxes, last, limits], {
    x: { type: "category" },
    y: { title: { text: `${title(of)}${inBrackets(history.units[names[0]])}` }, rangemode: "tozero", exponentformat: "SI" },
    more: { margin: { l: 64, r: 12, t: 12, b: 32 } },
  });
}
