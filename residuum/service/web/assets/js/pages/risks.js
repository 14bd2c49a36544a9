// Failure modes, effects and criticality: the matrix, and which diagnoser watches which mode.

import { call } from "../lib/api.js";
import { h, notify, panel, show } from "../lib/dom.js";
import { title } from "../lib/format.js";
import { plant } from "../lib/plant_state.js";
import { tableHead } from "../lib/table_head.js";

const SAYS = { red: "calls for a redesign", yellow: "tolerable", green: "acceptable" };
const HEADS = ["Component", "Failure", "Cause", "Effect", "Criticality", "Watched by"];

export function risksPage(place) {
  document.title = "Failure modes · Residuum";
  const about = h("p", { class: "muted about" });
  const body = h("div", { class: "stack" }, h("p", { class: "loading" }, "Loading …"));
  show(place, h("div", { class: "title" }, h("h1", {}, "Failure modes"), about), body);
  call("/failure-modes").then(
    (found) => {
      about.textContent = `How the ${title(found.machine)} can fail, how bad that is, and what watches it.`;
      show(body, panel("Criticality", "probability across, severity down", matrix(found)), panel("Modes", null, modes(found)));
    },
    (problem) => notify(problem.message),
  );
  return () => {};
}

function matrix({ probabilities, severities, cells }) {
  const cell = (severity, probability) => {
    const { risk, modes: there } = cells.find((each) => each.severity === severity && each.probability === probability);
    return h(
      "td",
      { class: "risk", "data-risk": risk, "data-label": `${probability} – ${probabilities[probability]}` },
      h("span", { class: "small" }, SAYS[risk]),
      there.map((id) =>
        h(
          "button",
          {
            type: "button",
            class: "link",
            onclick: () => document.getElementById(`mode-${id}`)?.scrollIntoView({ block: "center" }),
          },
          title(id),
        ),
      ),
    );
  };
  return h(
    "div",
    { class: "scroll", tabindex: 0, role: "group", "aria-label": "Criticality matrix" },
    h(
      "table",
      { class: "matrix reflow" },
      tableHead(["", ...Object.entries(probabilities).map(([key, text]) => `${key} – ${text}`)]),
      h(
        "tbody",
        {},
        Object.entries(severities).map(([severity, text]) =>
          h(
            "tr",
            {},
            h("th", { scope: "row" }, `${severity} – ${text}`),
            Object.keys(probabilities).map((probability) => cell(severity, probability)),
          ),
        ),
      ),
    ),
  );
}

function modes({ items }) {
  const watched = ({ covered_by: by }) =>
    by.length
      ? by.map(({ diagnoser, fault_class: name }) => h("div", {}, `${diagnoser}: ${name}`, machines(diagnoser)))
      : h("span", { class: "muted" }, "nothing yet");
  const row = (mode) =>
    h(
      "tr",
      { id: `mode-${mode.id}` },
      [
        h("b", {}, mode.component),
        mode.failure,
        mode.cause,
        mode.effect,
        `${mode.probability}-${mode.severity}, ${SAYS[mode.risk]}`,
        h("div", {}, watched(mode)),
      ].map((content, index) => h("td", { "data-label": HEADS[index] }, content)),
    );
  return h("div", { class: "scroll" }, h("table", { class: "reflow" }, tableHead(HEADS), h("tbody", {}, items.map(row))));
}

// The machines that this diagnoser judges.
function machines(diagnoser) {
  const found = [...plant.assets.values()].filter((asset) => asset.diagnoser === diagnoser);
  return found.map((asset) => [" ", h("a", { href: `#/machines/${encodeURIComponent(asset.id)}` }, asset.id)]);
}
