// What may be the cause of a finding, with probabilities; and what the model lacks now beside what it lacks when healthy.

import { draw, forget, series } from "../charts/charts.js";
import { call, path } from "../lib/api.js";
import { h, notify, once, panel, show } from "../lib/dom.js";
import { effectTitle } from "../lib/effect_titles.js";
import { capital, percent } from "../lib/format.js";
import { runIn } from "../lib/jobs.js";
import { placed, said, sentence } from "../lib/parts.js";
import { whyAddress } from "./why_address.js";

const MOST = 6;
const LEAST = 5e-4; // what is below is no cause: rounded it reads 0 %

export function causesPanel(asset) {
  const list = h("div");
  const picture = h("div", { class: "stack" });
  const leaving = [];
  const element = panel("Causes", null, list, picture);
  let shown = null;

  function update(finding) {
    if (finding === shown) return;
    shown = finding;
    const causes = likely(finding?.evidence?.causes);
    element.hidden = !finding?.evidence?.parameters && !finding?.evidence?.second_opinion;
    const look = () =>
      runIn(
        picture,
        "Estimating what the model lacks",
        path("assets", asset, "missing-terms"),
        { window: finding.window },
        (found) => drawPicture(picture, found),
        leaving,
        { fresh: true },
      );
    show(
      list,
      causes.length ? h("p", { class: "muted small" }, `In window ${finding.window}:`) : null,
      causes.length
        ? h("ul", { class: "plain" }, causes.slice(0, MOST).map(cause))
        : h("p", { class: "empty" }, nothing(finding)),
      secondOpinion(finding),
      missingPhysics(asset, finding),
      finding?.evidence?.parameters
        ? h(
            "p",
            { class: "next" },
            h(
              "button",
              { type: "button", class: "quiet", "data-key": "missing-now", onclick: look },
              "What does the model lack now, and when healthy?",
            ),
          )
        : null,
    );
  }

  const leave = () => {
    for (const each of leaving) each();
    for (const chart of picture.querySelectorAll(".chart")) forget(chart);
  };
  return { element, update, leave };
}

function nothing(finding) {
  if (!finding) return "Nothing has been judged yet.";
  if (finding.verdict === "not-assessable") return `Window ${finding.window} could not be judged. ${sentence(finding)}`;
  return `Window ${finding.window} shows nothing that needs a cause.`;
}

const likely = (causes) => (causes ?? []).filter((each) => each.probability >= LEAST);

function cause(each) {
  const place = each.place ? ` of ${each.place}` : "";
  const alike = each.indistinguishable_from.length
    ? ` This window cannot tell it from ${each.indistinguishable_from.map(placed).join(", ")}.`
    : "";
  const beside = each.beside?.length ? ` Beside it: ${each.beside.map(effectTitle).join(", ")}.` : "";
  return h("li", {}, h("b", {}, `${percent(each.probability)}: ${nameOf(each)}${place}. `), said(each.says), alike, beside);
}

// A parameter keeps its letters: `k` and `K` may be two of them.
const nameOf = ({ kind, name }) => (kind === "parameter" ? name : capital(effectTitle(name)));

// Physics that healthy windows show too is no fault: just these windows lead to the workbench.
function missingPhysics(asset, finding) {
  const missing = finding?.evidence?.missing_physics ?? [];
  if (!missing.length) return null;
  const names = missing.map((each) => `${effectTitle(each.effect)} of ${each.place}`).join(" and ");
  const lead = once(async () => {
    try {
      const healthy = await call(`${path("assets", asset, "findings")}?verdict=healthy&limit=3`);
      location.hash = await whyAddress(
        asset,
        healthy.items.map((each) => each.window),
      );
    } catch (problem) {
      notify(problem.message);
    }
  });
  return h(
    "div",
    {},
    h("p", {}, `Healthy windows show ${names} too, and the model lacks it. That is missing physics, not a fault.`),
    h(
      "p",
      { class: "next" },
      h(
        "button",
        { type: "button", class: "quiet", "data-key": "explain-healthy", onclick: lead },
        "Explain it with healthy windows",
      ),
    ),
  );
}

// What the second diagnoser says; where the two disagree that is said first.
function secondOpinion(finding) {
  const second = finding?.evidence?.second_opinion;
  if (!second) return null;
  const causes = likely(second.causes);
  const agree = second.verdict === finding.verdict;
  const word = agree
    ? "It agrees"
    : `It disagrees: ${finding.diagnoser} says ${finding.verdict}, ${second.diagnoser} says ${second.verdict}`;
  return h(
    "div",
    { class: "stack" },
    h("h3", {}, `Second opinion by ${second.diagnoser}`),
    h("p", {}, `${word}. ${second.reason ? said(second.reason) : ""}`),
    causes.length ? h("ul", { class: "plain" }, causes.slice(0, 3).map(cause)) : null,
  );
}

function drawPicture(place, { now, healthy }) {
  const pairs = now
    .filter((curve) => curve.at.length && curve.axis !== "time")
    .map((curve) => [curve, healthy.find((each) => each.of === curve.of && each.axis === curve.axis)]);
  const wanted = pairs.filter(([curve]) => pairs.findIndex(([other]) => other.of === curve.of) >= 0).slice(0, 4);
  if (!wanted.length) return show(place, h("p", { class: "empty" }, "Nothing can be drawn of this window."));
  const charts = wanted.map(([curve]) =>
    h("div", { class: "chart", role: "figure", "aria-label": `What ${curve.of} lacks along ${curve.axis}` }),
  );
  show(place, h("p", { class: "muted" }, "Solid: the window of now. Dashed: healthy windows, with their band."), charts);
  const [blue, orange] = series();
  for (const [index, [curve, before]] of wanted.entries()) {
    const line = (each, colour, dash, name) => ({
      type: "scatter",
      mode: "lines",
      name,
      x: each.at,
      y: each.mean,
      line: { color: colour, dash, width: 2 },
    });
    const edge = (each, side, fill) => ({
      type: "scatter",
      mode: "lines",
      x: each.at,
      y: each[side],
      line: { width: 0 },
      hoverinfo: "skip",
      fillcolor: `${blue}25`,
      ...(fill ? { fill: "tonexty" } : {}),
    });
    const traces = before ? [edge(before, "low"), edge(before, "high", true), line(before, blue, "dash", "healthy")] : [];
    draw(charts[index], [...traces, line(curve, orange, "solid", "now")], {
      x: { title: { text: curve.axis }, exponentformat: "SI" },
      y: { title: { text: `missing in ${curve.of}` }, exponentformat: "SI" },
    }).catch((problem) => notify(problem.message));
  }
  return undefined;
}
