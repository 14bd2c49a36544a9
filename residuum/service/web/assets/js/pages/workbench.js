// The workbench: record and model → compare → where → why → add. The address holds the whole view.

import { forget } from "../charts/charts.js";
import { keptAddress } from "../lib/address.js";
import { path } from "../lib/api.js";
import { h, notify, reveal, show } from "../lib/dom.js";
import { plant, subscribe } from "../lib/plant_state.js";
import { addStep } from "../steps/add_step.js";
import { compareStep } from "../steps/compare_step.js";
import { modelTitle } from "../steps/models.js";
import { recordStep } from "../steps/record_step.js";
import { whereStep } from "../steps/where_step.js";
import { whyStep } from "../steps/why_step.js";

const STEPS = [
  ["record", "Record and model", recordStep],
  ["compare", "Compare", compareStep],
  ["where", "Where", whereStep],
  ["why", "Why", whyStep],
  ["add", "Add", addStep],
];

// What the address says: records, model, version, map, step, and what a step keeps for itself.
class Bench {
  constructor(query) {
    const given = new URLSearchParams(query ?? "");
    this.records = (given.get("records") ?? "")
      .split(",")
      .map(Number)
      .filter((number) => number > 0);
    this.model = given.get("model");
    this.version = Number(given.get("version")) || null;
    this.map = parsed(given.get("map"));
    this.step = given.get("step") ?? "record";
    this.base = given.get("base");
    this.shown = parsed(given.get("shown"));
    this.leaving = [];
    this.keep = keptAddress();
  }

  get ready() {
    return this.records.length > 0 && Boolean(this.model);
  }

  // The body of every analysis.
  get asked() {
    return { records: this.records, ...(this.version ? { version: this.version } : {}), map: this.map };
  }

  address(noun) {
    return path("models", this.model, noun);
  }

  save() {
    const query = new URLSearchParams();
    if (this.records.length) query.set("records", this.records.join(","));
    for (const name of ["model", "version", "base", "step"]) if (this[name]) query.set(name, this[name]);
    for (const name of ["map", "shown"]) if (Object.keys(this[name]).length) query.set(name, JSON.stringify(this[name]));
    this.keep(`#/workbench?${query}`);
  }

  set(change) {
    Object.assign(this, change);
    this.save();
  }

  show(change) {
    this.set({ shown: { ...this.shown, ...change } });
  }
}

function parsed(text) {
  try {
    const value = JSON.parse(text ?? "{}");
    return value && typeof value === "object" ? value : {};
  } catch {
    return {};
  }
}

export function workbenchPage(place, query) {
  const bench = new Bench(query);
  const tabs = h("div", { class: "steps", role: "tablist", "aria-label": "Steps" });
  const about = h("p", { class: "muted about" });
  const compiling = h("p", { class: "muted", role: "status" });
  const body = h("div", { class: "step", role: "tabpanel", id: "step", "aria-labelledby": "", tabindex: -1 });
  document.title = "Workbench · Residuum";
  show(place, h("div", { class: "title" }, h("h1", {}, "Workbench"), about), compiling, tabs, body);

  // Whoever goes on by a button of the step before, goes on at the top of the new one by keyboard, too.
  bench.go = (step, change = {}) => {
    const inside = body.contains(document.activeElement);
    bench.set({ step, ...change });
    open();
    if (inside) body.focus({ preventScroll: true });
  };

  function drawTabs() {
    show(
      tabs,
      STEPS.map(([id, title], index) =>
        h(
          "button",
          {
            type: "button",
            role: "tab",
            id: `tab-${id}`,
            "data-key": `tab-${id}`,
            "aria-controls": "step",
            "aria-selected": String(id === bench.step),
            tabindex: id === bench.step ? 0 : -1,
            disabled: id !== "record" && !bench.ready,
            onclick: () => bench.go(id),
          },
          h("span", { class: "ordinal", "aria-hidden": "true" }, index + 1),
          title,
        ),
      ),
    );
    reveal(tabs, tabs.querySelector("[aria-selected=true]"));
    about.textContent = bench.ready
      ? `${modelTitle(bench.model, bench.version)} beside ` +
        `${bench.records.length === 1 ? `record ${bench.records[0]}` : `records ${bench.records.join(", ")}`}`
      : "Find out what a model is missing, from a record.";
  }

  tabs.addEventListener("keydown", (event) => {
    const way = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!way) return;
    const enabled = [...tabs.children].filter((tab) => !tab.disabled);
    const next = enabled[(enabled.indexOf(document.activeElement) + way + enabled.length) % enabled.length];
    next?.focus();
    next?.click();
  });

  function drawCompiling() {
    compiling.hidden = plant.status.compiled !== false;
    compiling.textContent = "What explanations need is being compiled, once; the first one waits for it and says so.";
  }

  function leave() {
    for (const each of bench.leaving.splice(0)) each();
    for (const chart of body.querySelectorAll(".chart")) forget(chart);
  }

  function open() {
    leave();
    if (!bench.ready) bench.step = "record";
    bench.refresh = drawTabs;
    drawTabs();
    body.setAttribute("aria-labelledby", `tab-${bench.step}`);
    const [, , draw] = STEPS.find(([id]) => id === bench.step) ?? STEPS[0];
    Promise.resolve(draw(body, bench)).catch((problem) => {
      if (problem.name !== "AbortError") notify(problem.message);
    });
  }

  const heard = subscribe((kind) => kind === "status" && drawCompiling());
  drawCompiling();
  open();
  return () => {
    heard();
    leave();
  };
}
