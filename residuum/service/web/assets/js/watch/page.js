// The guided way: from a machine to a watched machine. The address holds machine and step.

import { forget } from "../charts/charts.js";
import { keptAddress } from "../lib/address.js";
import { call, path } from "../lib/api.js";
import { h, notify, reveal, show } from "../lib/dom.js";
import { compareWindowsStep } from "./compare_windows_step.js";
import { healthyStep } from "./healthy_step.js";
import { modelStep } from "./model_step.js";
import { signalsStep } from "./signals_step.js";
import { sourceStep } from "./source_step.js";
import { trainStep } from "./train_step.js";
import { watchingStep } from "./watching_step.js";

const STEPS = [
  ["source", "Source", sourceStep],
  ["signals", "Live values", signalsStep],
  ["healthy", "Healthy windows", healthyStep],
  ["model", "Model", modelStep],
  ["compare", "Compare and improve", compareWindowsStep],
  ["train", "Train", trainStep],
  ["watching", "Watch", watchingStep],
];

// What the steps share: the machine, as the service has it, and what was chosen on the way.
class Way {
  constructor(query) {
    const given = new URLSearchParams(query ?? "");
    this.machine = given.get("machine");
    this.step = given.get("step") ?? "source";
    this.found = null;
    this.leaving = [];
    this.leftOut = new Set();
    this.keep = keptAddress();
  }

  get settings() {
    return this.found?.settings ?? null;
  }

  address(noun) {
    return path("assets", this.machine, noun);
  }

  async read() {
    if (this.machine) this.found = await call(this.address("machine"));
    return this.found;
  }

  // Watch the machine by changed settings.
  async put(changes) {
    this.found = await call(this.address("machine"), { method: "PUT", body: { ...this.settings, ...this.own, ...changes } });
    return this.found;
  }

  // What a setting of this kind of machine cannot have: it is not sent back.
  get own() {
    return { baseline: undefined, method: undefined };
  }

  save() {
    const query = new URLSearchParams();
    for (const name of ["machine", "step"]) if (this[name]) query.set(name, this[name]);
    this.keep(`#/watch?${query}`);
  }

  // Do something again and again until the step is left.
  every(milliseconds, work) {
    const timer = setInterval(() => work().catch((problem) => notify(problem.message)), milliseconds);
    this.leaving.push(() => clearInterval(timer));
    return work();
  }
}

export function watchPage(place, query) {
  const way = new Way(query);
  const tabs = h("div", { class: "steps", role: "tablist", "aria-label": "Steps" });
  const about = h("p", { class: "muted about" });
  const body = h("div", { class: "step", role: "tabpanel", id: "step", tabindex: -1 });
  document.title = "Watch a machine · Residuum";
  show(place, h("div", { class: "title" }, h("h1", {}, "Watch a machine"), about), tabs, body);

  way.go = (step) => {
    const inside = body.contains(document.activeElement);
    way.step = step;
    open();
    if (inside) body.focus({ preventScroll: true });
  };

  function drawTabs() {
    const tab = ([id, title], index) =>
      h(
        "button",
        {
          type: "button",
          role: "tab",
          id: `tab-${id}`,
          "data-key": `tab-${id}`,
          "aria-controls": "step",
          "aria-selected": String(id === way.step),
          tabindex: id === way.step ? 0 : -1,
          disabled: id !== "source" && !way.found,
          onclick: () => way.go(id),
        },
        h("span", { class: "ordinal", "aria-hidden": "true" }, index + 1),
        title,
      );
    show(tabs, STEPS.map(tab));
    reveal(tabs, tabs.querySelector("[aria-selected=true]"));
    about.textContent = way.machine ?? "From its bus to its alarms, in seven steps.";
  }

  tabs.addEventListener("keydown", (event) => {
    const direction = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!direction) return;
    const enabled = [...tabs.children].filter((tab) => !tab.disabled);
    const next = enabled[(enabled.indexOf(document.activeElement) + direction + enabled.length) % enabled.length];
    next?.focus();
    next?.click();
  });

  function leave() {
    for (const each of way.leaving.splice(0)) each();
    for (const chart of body.querySelectorAll(".chart")) forget(chart);
  }

  async function open() {
    leave();
    const opened = way.step;
    try {
      await way.read();
    } catch (problem) {
      if (problem.status !== 404) notify(problem.message);
      way.found = null;
      way.step = "source";
    }
    if (way.step !== opened && way.found) return;
    way.save();
    drawTabs();
    body.setAttribute("aria-labelledby", `tab-${way.step}`);
    const [, , draw] = STEPS.find(([id]) => id === way.step) ?? STEPS[0];
    Promise.resolve(draw(body, way)).catch((problem) => {
      if (problem.name !== "AbortError") notify(problem.message);
    });
  }

  open();
  return leave;
}
