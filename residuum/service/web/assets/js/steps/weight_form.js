// What a user chooses of an uncertainty weight: the number of models drawn, the weight's order, its frequencies.
// Defaults are the source's.

import { h } from "../lib/dom.js";

const RULES = { chernoff: "of a share (Chernoff)", "worst-case": "of a worst case" };
export const WEIGHT = { epsilon: "0.05", zeta: "0.05", rule: "chernoff", order: "2", points: "", lowest: "" };

/** Labelled fields of the weight; `asked` holds their values and is changed as they are typed. */
export function weightFields(asked, more = []) {
  const type = (key, label, attributes) =>
    h(
      "label",
      {},
      label,
      h("input", {
        type: "number",
        step: "any",
        "data-key": `weight-${key}`,
        value: asked[key],
        ...attributes,
        oninput: (event) => {
          asked[key] = event.target.value;
        },
      }),
    );
  const rule = h(
    "label",
    {},
    "number of models by a bound",
    h(
      "select",
      {
        "data-key": "weight-rule",
        onchange: (event) => {
          asked.rule = event.target.value;
        },
      },
      Object.entries(RULES).map(([value, text]) => h("option", { value, selected: value === asked.rule }, text)),
    ),
  );
  return [
    type("epsilon", "accuracy ε", { min: 0.005, max: 0.5, required: true }),
    type("zeta", "risk ζ", { min: 0.000001, max: 0.5, required: true }),
    rule,
    type("order", "order of W_T", { min: 0, max: 20, step: 1, required: true }),
    type("points", "frequencies of the grid", { min: 50, max: 5000, step: 1, placeholder: "600" }),
    type("lowest", "lowest frequency [rad/s]", { min: 0, placeholder: "5.5 decades below π/Ts" }),
    ...more,
  ];
}

/** The same as parameters of a request; fields left empty are left out. */
export function weightParameters(asked) {
  const names = { epsilon: "epsilon", zeta: "zeta", order: "weight_order", points: "points", lowest: "lowest" };
  const numbers = Object.entries(names).filter(([key]) => asked[key] !== "" && Number.isFinite(Number(asked[key])));
  return { ...Object.fromEntries(numbers.map(([key, name]) => [name, Number(asked[key])])), rule: asked.rule };
}

/** A fold-out that holds the fields. */
export function weightDetails(fields) {
  return h(
    "details",
    { class: "weight" },
    h("summary", { "data-key": "weight-more" }, "Uncertainty weight: models drawn, order, frequencies"),
    h("div", { class: "fields" }, fields),
  );
}
