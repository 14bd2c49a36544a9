// Step 6: learn what is healthy from the recorded windows.

import { h, panel, show } from "../lib/dom.js";
import { count } from "../lib/format.js";
import { runIn } from "../lib/jobs.js";
import { plant } from "../lib/plant_state.js";
import { methodSelect } from "../steps/deciding_method.js";

export function trainStep(place, way) {
  const result = h("div", { class: "stack" });
  const rate = h("input", { type: "number", min: 0.001, step: "any", value: 1, "data-key": "rate" });
  const fixed = h("input", { type: "checkbox", "data-key": "fix" });
  const method = methodSelect(way.settings.diagnoser);
  const kept = way.found.recorded_windows.filter((window) => !way.leftOut.has(window)).length;
  const train = () => {
    const body = { leave_out: [...way.leftOut] };
    if (method) body.method = method.value;
    if (ofModel) Object.assign(body, { fix_undetermined: fixed.checked, false_alarms_per_day: Number(rate.value) });
    return runIn(
      result,
      "Training: this takes some minutes",
      way.address("training"),
      body,
      (found) => drawTrained(result, way, found),
      way.leaving,
      { fresh: true },
    );
  };
  const ofModel = plant.diagnosers.get(way.settings.diagnoser)?.views.includes("tracks") ?? true;
  const from = way.found.baseline
    ? "windows that the present baseline judged healthy"
    : recorded(kept, way.found.learned_from_at_most);
  const by = ofModel ? `, with the model ${way.settings.model ?? "– none is chosen yet"}` : "";
  show(
    place,
    panel(
      "Train",
      null,
      h(
        "div",
        { class: "stack" },
        h("p", {}, `The diagnoser learns from ${from} what is usual${by}.`),
        h(
          "div",
          { class: "controls" },
          ofModel ? h("label", {}, "false alarms a day that you accept", rate) : null,
          ofModel ? h("label", {}, fixed, "keep values that the windows leave open") : null,
          method ? h("label", {}, "what decides", method) : null,
          h("button", { type: "button", "data-key": "train", onclick: train }, "Train"),
        ),
        result,
      ),
    ),
  );
}

const recorded = (kept, most) =>
  kept > most ? `the newest ${count(most)} of ${count(kept)} recorded windows` : `${count(kept)} recorded windows`;

function drawTrained(place, way, found) {
  show(
    place,
    h(
      "p",
      { role: "status" },
      `Trained on ${count(found.windows)} windows; ${count(found.alarms)} of them would raise an alarm.`,
      found.passed_over ? ` Passed over, since samples are missing: ${count(found.passed_over)}.` : null,
    ),
    h(
      "ul",
      { class: "plain" },
      (found.learned.says ?? []).map((line) => h("li", {}, line.trim())),
    ),
    h(
      "p",
      { class: "next" },
      h("button", { type: "button", "data-key": "next", onclick: () => way.go("watching") }, "Watch the machine"),
    ),
  );
}
