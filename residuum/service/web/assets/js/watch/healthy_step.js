// Step 3: windows are recorded while the machine is healthy and at work; one that was not is left out.

import { call, path } from "../lib/api.js";
import { h, panel, show } from "../lib/dom.js";
import { count, span } from "../lib/format.js";

export const ENOUGH = 20;
const FEWEST = 5;

export async function healthyStep(place, way) {
  const head = h("p", { class: "says-large" });
  const bar = h("i", { style: { width: "0%" } });
  const progress = h(
    "div",
    { class: "progress", role: "progressbar", "aria-label": "Healthy windows", "aria-valuemin": 0, "aria-valuemax": ENOUGH },
    bar,
  );
  const list = h("div", { class: "choices", role: "group", "aria-label": "Recorded windows" });
  const next = h(
    "button",
    { type: "button", "data-key": "next", disabled: true, onclick: () => way.go("model") },
    "Go on to the model",
  );
  show(
    place,
    panel(
      "Record healthy windows",
      null,
      h(
        "div",
        { class: "stack" },
        head,
        progress,
        h(
          "p",
          { class: "muted" },
          "Let the machine work as it does on any day: all speeds, loads and temperatures. " +
            "Take the tick from a window in which it was not healthy.",
        ),
        list,
        h("p", {}, next),
      ),
    ),
  );
  let drawn = -1;
  await way.every(1500, async () => {
    const { recorded_windows: windows, baseline } = await way.read();
    const kept = windows.filter((window) => !way.leftOut.has(window));
    const share = Math.min(ENOUGH, kept.length);
    bar.style.width = `${(100 * share) / ENOUGH}%`;
    progress.setAttribute("aria-valuenow", share);
    head.textContent = said(kept.length, way.settings.window.length, baseline);
    next.disabled = kept.length < FEWEST;
    if (windows.length === drawn) return;
    drawn = windows.length;
    show(
      list,
      [...windows].reverse().map((window) => choice(way, window)),
    );
  });
}

function said(number, seconds, baseline) {
  if (baseline)
    return "This machine has a baseline already. Its windows are judged; train again to learn from those judged healthy.";
  const left = ENOUGH - number;
  if (left <= 0) return `${count(number)} windows are recorded. That is enough.`;
  return `${count(number)} of ${ENOUGH} windows are recorded. The others take ${span(left * seconds)} at least.`;
}

function choice(way, window) {
  const tick = h("input", {
    type: "checkbox",
    "data-key": `healthy-${window}`,
    checked: !way.leftOut.has(window),
    onchange: (event) => {
      way.leftOut[event.target.checked ? "delete" : "add"](window);
      way.compared = null;
    },
  });
  const says = h("span", { class: "muted small" });
  call(path("assets", way.machine, "windows", window))
    .then(({ window: one }) => {
      says.textContent = `${count(one.n)} samples, ${new Date(one.received_at).toLocaleTimeString()}`;
    })
    .catch(() => {});
  return h("label", { class: "choice" }, tick, h("span", { class: "name" }, `window ${window}`), says);
}
