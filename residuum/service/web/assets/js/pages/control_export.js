// A controller for the target: coefficients, difference equation, C and structured text to download.

import { h, panel } from "../lib/dom.js";
import { download } from "../lib/report_file.js";
import { tableHead } from "../lib/table_head.js";

const LANGUAGES = { c: ["C", "controller.c", "text/x-c"], st: ["structured text (IEC 61131-3)", "controller.st", "text/plain"] };
const lag = (index) => (index ? `k − ${index}` : "k");

export function exportPanel(view, point) {
  const file = {
    structure: view.structure,
    aim: view.aim,
    parameters: point.parameters,
    ...point.controller,
    difference_equation: point.difference_equation,
    cost: point.cost,
    robust_stability_norm: point.robust_stability_norm,
  };
  const save = (name, text, type) =>
    h(
      "button",
      { type: "button", class: "quiet", "data-key": `save-${name}`, onclick: () => download(name, text, type) },
      `Download ${name}`,
    );
  const row = (index) =>
    h(
      "tr",
      {},
      h("th", { scope: "row" }, lag(index)),
      h("td", { "data-label": "b, of the error e", class: "number" }, String(point.b[index])),
      h("td", { "data-label": "a, of the output u", class: "number" }, index ? String(point.a[index - 1]) : "1"),
    );
  const source = ([name, text]) =>
    h("details", {}, h("summary", {}, `Show ${LANGUAGES[name][0]}`), h("pre", { tabindex: 0 }, text));
  return panel(
    "For the target",
    "with a self-test vector each",
    h(
      "div",
      { class: "stack" },
      h(
        "div",
        { class: "controls" },
        Object.entries(point.exports).map(([name, text]) => save(LANGUAGES[name][1], text, LANGUAGES[name][2])),
        save("controller.json", `${JSON.stringify(file, null, 1)}\n`, "application/json"),
      ),
      h("pre", { tabindex: 0 }, point.difference_equation),
      h(
        "div",
        { class: "scroll" },
        h(
          "table",
          { class: "reflow" },
          tableHead(["Sample", "b, of the error e", "a, of the output u"], [1, 2]),
          h(
            "tbody",
            {},
            point.b.map((_, index) => row(index)),
          ),
        ),
      ),
      Object.entries(point.exports).map(source),
    ),
  );
}
