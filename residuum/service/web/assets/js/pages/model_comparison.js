// Several identified models side by side: a row a method and order, their frequency responses in one diagram.

import { draw, series } from "../charts/charts.js";
import { call, path } from "../lib/api.js";
import { h, notify, panel, show } from "../lib/dom.js";
import { number, percent, quantity, unitText } from "../lib/format.js";
import { run } from "../lib/jobs.js";
import { tableHead } from "../lib/table_head.js";

const HEADS = ["Model", "Order", "Fit", "Error on new data", "AIC", "Noise", "Residual tests", ""];
const DASHES = ["solid", "dash", "dot", "dashdot"];

const fits = (values) => (values?.length ? values.map((fit) => (fit === null ? "–" : percent(fit / 100))).join(", ") : "–");
const orderOf = (model) => (model.denominator ? model.denominator.length - 1 : model.order);
const tested = ({ check }) => (check?.parts.length ? (check.passed ? "passed" : "not passed") : "–");
// The RMS error that the .632+ bootstrap expects of data that the model was not identified from; a fit to its own data would
// always praise the largest order.
const newError = ({ check }) => (check?.bootstrap ? Math.sqrt(check.bootstrap.error) : null);
const ranked = (found) =>
  found
    .filter((each) => each.model)
    .sort((a, b) => (newError(a.model) ?? Infinity) - (newError(b.model) ?? Infinity) || (a.model.aic ?? 0) - (b.model.aic ?? 0));

// Identifies by every one of `asked` = [{ title, body }] one after the other; `choose` is told the model that is to be shown
// whole, first the one of the least error on new data.
export async function compareModels(place, asked, choose, leaving) {
  const stop = new AbortController();
  leaving.push(() => stop.abort());
  const found = [];
  const chart = h("div", { class: "chart overlay", role: "figure", "aria-label": "Bode diagrams of the models" });
  const list = h("div");
  let chosen = null;
  show(place, panel("Models side by side", `${asked.length} models, least error on new data first`, list, chart));

  const pick = (model) => {
    chosen = model;
    drawList();
    choose(model);
  };
  function drawList() {
    const waiting = asked.length - found.length;
    show(
      list,
      h(
        "div",
        { class: "scroll" },
        h(
          "table",
          { class: "reflow" },
          tableHead([...HEADS.slice(0, 7), h("span", { class: "visually-hidden" }, "Action")], [1, 2, 3, 4, 5]),
          h(
            "tbody",
            {},
            ranked(found).map((each) => row(each, chosen, pick)),
          ),
        ),
      ),
      found.filter((each) => each.refused).map((each) => h("p", { class: "small" }, `${each.title}: ${each.refused}`)),
      waiting ? h("p", { class: "muted", role: "status" }, `Identifying: ${asked[found.length].title}, ${waiting} to go`) : null,
    );
  }

  drawList();
  for (const { title, body } of asked) {
    try {
      const model = await run("/identify", body, { signal: stop.signal });
      const at = `${path("models", model.stored.model, "frequency-response")}?version=${model.stored.version}`;
      found.push({ title, model, response: await call(at, { signal: stop.signal }) });
    } catch (problem) {
      if (problem.name === "AbortError") return;
      found.push({ title, refused: problem.message });
    }
    if (!place.isConnected) return;
    drawList();
    await drawAll(chart, found).catch((problem) => notify(problem.message));
  }
  const best = ranked(found)[0];
  if (best && !chosen) pick(best.model);
}

function row({ title, model }, chosen, pick) {
  const cells = [
    h("b", {}, title),
    number(orderOf(model)),
    fits(model.fit_percent),
    quantity(newError(model), model.output.unit),
    number(model.aic),
    quantity(Math.sqrt(model.noise_variance), model.output.unit),
    tested(model),
    h(
      "button",
      {
        type: "button",
        class: "quiet",
        "data-key": `show-${title}`,
        "aria-pressed": String(model === chosen),
        "aria-label": `Show ${title}`,
        onclick: () => pick(model),
      },
      model === chosen ? "Shown below" : "Show",
    ),
  ];
  return h(
    "tr",
    {},
    cells.map((cell, index) => h("td", { "data-label": HEADS[index], class: index > 0 && index < 6 ? "number" : null }, cell)),
  );
}

function drawAll(chart, found) {
  const colours = series();
  const known = found.filter((each) => each.model);
  if (!known.length) return Promise.resolve();
  const { input, output } = known[0].model;
  const line = (index, y, more) => ({
    type: "scatter",
    mode: "lines",
    name: known[index].title,
    x: known[index].response.frequency,
    y,
    line: { width: 1.8, color: colours[index % 4], dash: DASHES[Math.floor(index / 4) % 4] },
    hovertemplate: "%{x:.4~g} Hz<br>%{y:.4~g}<extra></extra>",
    ...more,
  });
  return draw(
    chart,
    known.flatMap(({ response }, index) => [
      line(index, response.magnitude),
      line(index, response.phase, { yaxis: "y2", showlegend: false }),
    ]),
    {
      x: { title: { text: "frequency [Hz]" }, type: "log", anchor: "y2" },
      y: {
        title: { text: `magnitude [${unitText(output.unit) || "1"} / ${unitText(input.unit) || "1"}]` },
        type: "log",
        exponentformat: "SI",
        domain: [0.48, 1],
      },
      y2: { title: { text: "phase [°]" }, domain: [0, 0.4] },
      more: {
        showlegend: true,
        legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 },
        margin: { l: 64, r: 12, t: 34, b: 42 },
      },
    },
  );
}
