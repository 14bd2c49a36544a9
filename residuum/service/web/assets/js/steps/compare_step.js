// Step 2: how large is the error, and is there anything in it but noise?

import { overlay } from "../charts/overlay.js";
import { h, panel, show } from "../lib/dom.js";
import { number, percent, quantity } from "../lib/format.js";
import { runIn } from "../lib/jobs.js";
import { badge } from "../lib/parts.js";
import { tableHead } from "../lib/table_head.js";
import { optionsOf } from "./options.js";

// " (p = 0.03)", without digits that mean nothing.
const chance = (p) => (p < 1e-4 ? " (p < 0.0001)" : ` (p = ${number(p)})`);

export function structured(comparison) {
  const test = comparison.structured_error;
  return test.present
    ? [
        "faulty",
        "Structured error",
        `The model lacks something: ${percent(test.share)} of the error's power is structured${chance(test.p_value)}.`,
      ]
    : ["healthy", "Only noise is left", `Noise alone explains the whole error${chance(test.p_value)}.`];
}

export async function compareStep(place, bench) {
  const body = h("div", { class: "stack" });
  show(place, body);
  const options = await optionsOf(bench, "views", () => bench.go("compare"));
  if (!body.isConnected) return undefined; // the step has been left
  place.append(options.form);
  return runIn(
    body,
    "Comparing the model with the record",
    bench.address("views"),
    options.body(),
    (view) => drawView(body, bench, view),
    bench.leaving,
  );
}

function drawView(body, bench, view) {
  const { comparison, signals } = view;
  const outputs = Object.keys(comparison.outputs);
  const chosen = outputs.includes(bench.shown.output) ? bench.shown.output : outputs[0];
  const record = Math.min(bench.shown.record ?? 0, signals.length - 1);
  const [tone, word, sentence] = structured(comparison);
  const redraw = (change) => {
    bench.show(change);
    drawView(body, bench, view);
  };
  const pick = (label, values, value, take) =>
    values.length < 2
      ? null
      : h(
          "label",
          {},
          label,
          h(
            "select",
            { "data-key": label, onchange: (event) => take(event.target.selectedIndex) },
            values.map((each) => h("option", { selected: each === value }, each)),
          ),
        );
  const chart = overlay(chosen, comparison.outputs[chosen].unit, [{ record: signals[record], label: "simulated" }], {
    range: bench.shown.range ?? null,
    onRange: (range) => bench.show({ range }),
  });
  show(
    body,
    h(
      "div",
      { class: "verdict" },
      badge(tone, word),
      h("p", { class: "says-large" }, sentence),
      h("button", { type: "button", "data-key": "next", onclick: () => bench.go("where") }, "Where does it fail?"),
    ),
    h(
      "section",
      { class: "panel" },
      h(
        "header",
        {},
        h("h2", {}, "Measured and simulated"),
        h(
          "div",
          { class: "controls" },
          pick("output", outputs, chosen, (index) => redraw({ output: outputs[index] })),
          pick("record", bench.records.map(String), String(bench.records[record]), (index) =>
            redraw({ record: index, range: null }),
          ),
          bench.shown.range
            ? h(
                "button",
                { type: "button", class: "quiet", "data-key": "whole", onclick: () => redraw({ range: null }) },
                "Whole record",
              )
            : null,
        ),
      ),
      h("div", { class: "body" }, chart),
    ),
    panel("Error of every output", "simulation with the parameters as they are", errorTable(comparison)),
  );
}

function errorTable(comparison) {
  const heads = ["Output", "RMS error", "Noise floor", "Fit", "Bias", "Predicted ahead"];
  const row = ([name, output]) =>
    h(
      "tr",
      {},
      h("td", { "data-label": heads[0] }, name),
      h("td", { "data-label": heads[1], class: "number" }, quantity(output.rmse, output.unit)),
      h("td", { "data-label": heads[2], class: "number" }, quantity(output.noise_floor, output.unit)),
      h("td", { "data-label": heads[3], class: "number" }, output.fit_percent === null ? "–" : percent(output.fit_percent / 100)),
      h("td", { "data-label": heads[4], class: "number" }, quantity(output.bias, output.unit)),
      h(
        "td",
        { "data-label": heads[5] },
        output.k_step.map((step) => `${step.samples}: ${quantity(step.rmse, output.unit)}`).join(" · "),
      ),
    );
  const balances = Object.entries(comparison.balances).map(([name, each]) =>
    h(
      "li",
      {},
      `Missing term of balance ${name}: ${quantity(each.missing_rms, each.unit)} RMS, ` +
        `${percent(each.relative_percent / 100)} of what drives it.`,
    ),
  );
  return [
    h(
      "div",
      { class: "scroll" },
      h(
        "table",
        { class: "reflow" },
        tableHead(heads, [1, 2, 3, 4]),
        h("tbody", {}, Object.entries(comparison.outputs).map(row)),
      ),
    ),
    balances.length ? h("ul", { class: "plain" }, balances) : null,
  ];
}
