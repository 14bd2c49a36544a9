// Step 3: where does the model fail? Clouds of missing terms and residuals; a region or point leads to its movement.

import { draw, series } from "../charts/charts.js";
import { cloudChart, drawCloud } from "../charts/cloud.js";
import { h, show } from "../lib/dom.js";
import { capital, inBrackets, localised, percent, quantity } from "../lib/format.js";
import { runIn } from "../lib/jobs.js";
import { tableHead } from "../lib/table_head.js";
import { optionsOf } from "./options.js";

export async function whereStep(place, bench) {
  const body = h("div", { class: "stack" });
  show(place, body);
  const options = await optionsOf(bench, "views");
  if (!body.isConnected) return undefined; // the step has been left
  return runIn(
    body,
    "Smoothing what each balance lacks",
    bench.address("views"),
    options.body(),
    (view) => drawView(body, bench, view),
    bench.leaving,
  );
}

const select = (label, values, value, take) =>
  h(
    "label",
    {},
    label,
    h(
      "select",
      { "data-key": label, onchange: (event) => take(values[event.target.selectedIndex]) },
      values.map((each) => h("option", { selected: each === value }, each)),
    ),
  );

function drawView(body, bench, view) {
  const terms = view.points.terms.map((term) => term.of);
  const axes = view.points.axes.map((axis) => axis.name);
  const of = terms.includes(bench.shown.of) ? bench.shown.of : (worstBalance(view) ?? terms[0]);
  const axis = axes.includes(bench.shown.axis) ? bench.shown.axis : naturalAxis(view);
  const chart = cloudChart(`${of} against ${axis}`);
  const spectrum = h("div", { class: "chart", role: "figure", "aria-label": "Residual over frequency" });
  const redraw = (change) => {
    bench.show(change);
    drawView(body, bench, view);
  };
  const largest = strongest(view, { of, axis, from: -Infinity, to: Infinity });
  show(
    body,
    h(
      "div",
      { class: "columns" },
      h(
        "section",
        { class: "panel span-8" },
        h(
          "header",
          {},
          h("h2", {}, "What is missing"),
          h(
            "div",
            { class: "controls" },
            select("of", terms, of, (value) => redraw({ of: value, interval: null })),
            select("against", axes, axis, (value) => redraw({ axis: value, interval: null })),
          ),
        ),
        h(
          "div",
          { class: "body" },
          chart,
          h(
            "p",
            { class: "controls muted small" },
            "Click a sample to see the movement it comes from.",
            largest
              ? h(
                  "button",
                  { type: "button", class: "quiet", "data-key": "largest", onclick: () => toMovement(bench, view, ...largest) },
                  `See the largest, at ${quantity(largest[1], "s")}`,
                )
              : null,
          ),
        ),
      ),
      h(
        "section",
        { class: "panel span-4" },
        h("header", {}, h("h2", {}, "Regions")),
        h("div", { class: "body" }, regionList(view, bench, of, axis, axes, redraw)),
      ),
    ),
    h(
      "div",
      { class: "columns" },
      phaseMap(view, bench, of),
      h(
        "section",
        { class: "panel span-7" },
        h(
          "header",
          {},
          h("h2", {}, "Residual over frequency"),
          h("div", { class: "aside" }, "flat where only white noise is left"),
        ),
        h("div", { class: "body" }, spectrum),
      ),
    ),
    h(
      "p",
      { class: "next" },
      h("button", { type: "button", "data-key": "next", onclick: () => bench.go("why") }, "Why does it fail?"),
    ),
  );
  queueMicrotask(() => {
    drawCloud(chart, view, of, axis, {
      interval: bench.shown.interval,
      onPoint: (record, time) => toMovement(bench, view, record, time),
    });
    drawSpectra(spectrum, view.spectra);
  });
}

// The balance that lacks most of what drives it.
function worstBalance(view) {
  const lacking = Object.entries(view.comparison.balances).filter(([, each]) => Number.isFinite(each.relative_percent));
  return lacking.sort(([, a], [, b]) => b.relative_percent - a.relative_percent)[0]?.[0];
}

// Speed, temperature or level where there is one: most physics shows against them.
export function naturalAxis(view) {
  const { axes } = view.points;
  return (axes.find((axis) => ["velocity", "temperature", "level"].includes(axis.kind)) ?? axes[0]).name;
}

function regionList(view, bench, of, axis, axes, redraw) {
  if (!view.comparison.where.length) return h("p", { class: "empty" }, "No region stands out: the error is alike everywhere.");
  return h(
    "ol",
    { class: "regions" },
    view.comparison.where.map((region, index) => {
      const here = region.of === of && region.axis === axis;
      const movement = axes.includes(region.axis) ? strongest(view, region) : null;
      return h(
        "li",
        { "data-here": here },
        h(
          "button",
          {
            type: "button",
            class: "region",
            "data-key": `region-${index}`,
            "aria-pressed": String(here),
            disabled: !axes.includes(region.axis),
            onclick: () => redraw({ of: region.of, axis: region.axis, interval: [region.from, region.to] }),
          },
          h("span", {}, capital(localised(region.says))),
          h(
            "span",
            { class: "muted small" },
            `of ${region.of}: ${percent(region.share)} of its power in ${percent(region.time_share)} of the ` +
              `${region.axis === "frequency" ? "spectrum" : "time"}`,
          ),
        ),
        movement
          ? h(
              "button",
              {
                type: "button",
                class: "quiet small",
                "data-key": `movement-${index}`,
                onclick: () => toMovement(bench, view, ...movement),
              },
              `See it at ${quantity(movement[1], "s")}`,
            )
          : null,
      );
    }),
  );
}

// The error of each phase and direction, the more coloured the larger; a cell leads to its worst moment.
function phaseMap(view, bench, of) {
  const map = view.phases.find((each) => each.of === of);
  if (!map)
    return h(
      "section",
      { class: "panel span-5" },
      h("header", {}, h("h2", {}, "By phase and direction")),
      h(
        "div",
        { class: "body" },
        h("p", { class: "empty" }, "This model has no speed, temperature or level whose phases could be told apart."),
      ),
    );
  const largest = Math.max(...map.cells.map((cell) => cell.rms)) || 1;
  const cell = (phase, direction) => {
    const found = map.cells.find((each) => each.phase === phase && each.direction === direction);
    if (!found) return h("td", { class: "muted" }, "–");
    const button = h(
      "button",
      {
        type: "button",
        class: "cell",
        "data-key": `cell-${phase}-${direction}`,
        "aria-label":
          `${phase}, ${direction}: ${quantity(found.rms, map.unit)} RMS, ${percent(found.share)} of the ` +
          `error's power; see it at ${quantity(found.time, "s")}`,
        onclick: () => toMovement(bench, view, found.record, found.time),
      },
      h("b", { class: "number" }, quantity(found.rms, map.unit)),
      h("span", { class: "small" }, `${percent(found.share)} of the power in ${percent(found.time_share)} of the time`),
    );
    button.style.setProperty("--heat", `${Math.round(45 * (found.rms / largest))}%`);
    return h("td", {}, button);
  };
  return h(
    "section",
    { class: "panel span-5" },
    h("header", {}, h("h2", {}, "By phase and direction"), h("div", { class: "aside" }, `of ${map.axis}`)),
    h(
      "div",
      { class: "body" },
      h(
        "div",
        { class: "scroll", tabindex: 0, role: "group", "aria-label": "Error by phase and direction" },
        h(
          "table",
          { class: "heat" },
          tableHead(["", ...map.directions.map(capital)]),
          h(
            "tbody",
            {},
            map.phases.map((phase) =>
              h(
                "tr",
                {},
                h("th", { scope: "row" }, capital(phase)),
                map.directions.map((direction) => cell(phase, direction)),
              ),
            ),
          ),
        ),
      ),
      h(
        "p",
        { class: "muted small" },
        `RMS of what ${of} ${map.unit && view.comparison.balances[of] ? "lacks" : "errs"}. Choose a cell to see its ` +
          `worst moment.`,
      ),
    ),
  );
}

// Record and time of the region's largest error.
function strongest(view, region) {
  const values = view.points.axes.find((each) => each.name === region.axis).values;
  const errors = view.points.terms.find((each) => each.of === region.of)?.value ?? [];
  let best = null;
  errors.forEach((error, index) => {
    if (
      error !== null &&
      values[index] >= region.from &&
      values[index] <= region.to &&
      (best === null || Math.abs(error) > Math.abs(errors[best]))
    )
      best = index;
  });
  return best === null ? null : [view.points.record[best], view.points.time[best]];
}

function toMovement(bench, view, record, time) {
  const last = Math.max(...view.points.time.filter((_, index) => view.points.record[index] === record));
  const half = last * 0.04;
  bench.go("compare", { shown: { ...bench.shown, record, range: [Math.max(0, time - half), Math.min(last, time + half)] } });
}

function drawSpectra(place, spectra) {
  const colours = series();
  const traces = spectra.map((each, index) => ({
    type: "scatter",
    mode: "lines",
    name: `${each.of}${inBrackets(each.unit)}`,
    x: each.amplitude.map((_, line) => (line + 0.5) * each.step),
    y: each.amplitude,
    line: { width: 1.2, color: colours[index % 4], dash: index ? "dot" : "solid" },
    hovertemplate: "%{x:.4~g} Hz<br>%{y:.4~g}<extra></extra>",
  }));
  return draw(place, traces, {
    x: { title: { text: "frequency [Hz]" }, type: "log" },
    y: { title: { text: "amplitude [see legend]" }, type: "log", exponentformat: "SI" },
    more: {
      showlegend: true,
      legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 },
      margin: { l: 64, r: 12, t: 34, b: 42 },
    },
  });
}
