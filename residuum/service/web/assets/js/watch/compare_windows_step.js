// Step 5: hold the model against recorded windows, and let what it lacks be added.

import { call, path } from "../lib/api.js";
import { h, notify, once, panel, show } from "../lib/dom.js";
import { number, percent, quantity } from "../lib/format.js";
import { runIn } from "../lib/jobs.js";
import { badge, placed } from "../lib/parts.js";
import { tableHead } from "../lib/table_head.js";
import { structured } from "../steps/compare_step.js";

const MOST = 2;

export async function compareWindowsStep(place, way) {
  const result = h("div", { class: "stack" });
  const improved = h("div", { class: "stack" });
  const { model } = way.settings;
  if (!model) return show(place, panel("Compare", null, h("p", { class: "empty" }, "Choose a model first.")));
  const windows = way.found.recorded_windows.filter((window) => !way.leftOut.has(window));
  if (!windows.length) return show(place, panel("Compare", null, h("p", { class: "empty" }, "No window is recorded yet.")));
  const train = h(
    "button",
    { type: "button", class: "quiet", "data-key": "next", onclick: () => way.go("train") },
    "Train with this model",
  );
  const said = h("span");
  show(place, panel(`Is the model ${model} right?`, said, result, h("p", { class: "next" }, train)), improved);
  try {
    way.compared ??= await call(way.address("records"), { method: "POST", body: { windows, complete: MOST } });
  } catch (problem) {
    return show(result, h("p", { class: "empty" }, problem.message));
  }
  way.records = way.compared.records;
  said.textContent = `on ${way.compared.windows.map((window) => `window ${window}`).join(" and ")}`;
  const asked = { records: way.records };
  return runIn(
    result,
    "Comparing the model with recorded windows",
    path("models", model, "compare"),
    asked,
    (found) => drawComparison(result, improved, way, found),
    way.leaving,
    { fresh: true },
  );
}

function drawComparison(place, improved, way, found) {
  const [tone, word, sentence] = structured(found);
  const rows = Object.entries(found.outputs).map(([name, output]) =>
    h(
      "tr",
      {},
      h("td", { "data-label": "Output" }, name),
      h("td", { "data-label": "RMS error", class: "number" }, quantity(output.rmse, output.unit)),
      h("td", { "data-label": "Noise", class: "number" }, quantity(output.noise_floor, output.unit)),
      h("td", { "data-label": "Fit", class: "number" }, output.fit_percent === null ? "–" : percent(output.fit_percent / 100)),
    ),
  );
  const { model } = way.settings;
  const improve = () =>
    runIn(
      improved,
      "Looking for what the model lacks",
      path("models", model, "improve"),
      { records: way.records, auto: true, save_as: savedAs(way) },
      (better) => drawImproved(improved, way, better),
      way.leaving,
      { fresh: true },
    );
  const bench = `#/workbench?${new URLSearchParams({ records: way.records.join(","), model, step: "where" })}`;
  show(
    place,
    h("div", { class: "verdict" }, badge(tone, word), h("p", {}, sentence)),
    h("table", { class: "reflow" }, tableHead(["Output", "RMS error", "Noise", "Fit"], [1, 2, 3]), h("tbody", {}, rows)),
    h(
      "p",
      { class: "controls" },
      h("button", { type: "button", "data-key": "improve", onclick: improve }, "Improve the model"),
      h("a", { href: bench }, "See on the workbench where it fails"),
    ),
  );
}

// A built-in model cannot get a new version: the improved one is then the machine's own.
const savedAs = (way) => (way.settings.model.includes(way.machine) ? way.settings.model : `${way.machine}-model`);

function drawImproved(place, way, found) {
  const step = (each) =>
    h(
      "li",
      {},
      each.added ? `${placed(each.at ? `${each.added}@${each.at}` : each.added)} added: ` : "at first: ",
      `error ${each.error === null ? "–" : quantity(each.error, found.error_unit)}`,
    );
  const use = once(async () => {
    try {
      await way.put({ model: found.stored.model });
      way.go("train");
    } catch (problem) {
      notify(problem.message);
    }
  });
  show(
    place,
    panel(
      "The improved model",
      `version ${number(found.stored.version)} of ${found.stored.model}`,
      h("ul", { class: "plain" }, found.history.map(step)),
      h(
        "p",
        {},
        found.verdict === "adequate"
          ? "Nothing but noise is left."
          : "Something is still left. What stays is taken as the machine's healthy behaviour.",
      ),
      h(
        "p",
        { class: "next" },
        h("button", { type: "button", "data-key": "use-improved", onclick: use }, "Use the improved model"),
      ),
    ),
  );
}
