// Design a robust controller from identified models: what is possible, what it promises, how it behaves, code for the target.

import { forget } from "../charts/charts.js";
import { drawConstraints, drawFront, drawLoop, drawSteps } from "../charts/control_charts.js";
import { keptAddress } from "../lib/address.js";
import { call } from "../lib/api.js";
import { h, notify, panel, show } from "../lib/dom.js";
import { capital, number, percent, quantity, unitText } from "../lib/format.js";
import { runIn } from "../lib/jobs.js";
import { modelName } from "../lib/model_name.js";
import { adapted, fieldsOf, questionForm } from "../lib/question_form.js";
import { offer, PROCESS, simulateIn } from "../steps/example.js";
import { exportPanel } from "./control_export.js";

// What the address named otherwise once.
const EARLIER = {
  settling: "settling_time",
  lowGain: "low_gain",
  highGain: "high_gain",
  critical: "critical_frequency",
  order: "weight_order",
};
const FIRST = "aim structure only in_time overshoot settling_time slack low_gain high_gain critical_frequency limits".split(" ");

const HINT =
  "Choose an identified model and press Design, or try a simulated process that is identified first. " +
  "The design shows what is possible, what is promised, and code to download.";

export function controlPage(place, query) {
  document.title = "Control · Residuum";
  const asked = addressed(new URLSearchParams(query ?? ""));
  const form = h("div");
  const result = h("div", { class: "stack" });
  const leaving = [];
  show(
    place,
    h(
      "div",
      { class: "title" },
      h("h1", {}, "Control"),
      h(
        "p",
        { class: "muted about" },
        "A controller with a guarantee, from identified models and their uncertainty; no weight is chosen by hand.",
      ),
    ),
    form,
    result,
  );

  const keep = keptAddress();
  const save = () => keep(`#/control?${new URLSearchParams(Object.entries(asked).filter(([, text]) => text))}`);
  const pick = (point) => {
    asked.point = String(point);
    save();
  };
  let question = null;
  let declared = null;
  let stored = [];

  function begin({ again = false } = {}) {
    if (again) delete asked.point;
    const { models = [], joined, ...said } = question?.body() ?? {};
    if (!models.length) return notify("Choose a model first.");
    save();
    runIn(
      result,
      "Designing controllers along the front of what is possible",
      "/control-designs/views",
      { ...said, models: models.map(versionOf), ...(joined ? { joined: versionOf(joined) } : {}) },
      (view) => drawDesign(result, view, said.limits ?? [], asked.point, pick),
      leaving,
    );
  }

  function drawForm() {
    if (!stored.length)
      return show(
        form,
        panel(
          "Models",
          null,
          h(
            "p",
            { class: "empty" },
            "No identified model yet: ",
            h("a", { href: "#/identify" }, "identify one from a record"),
            ".",
          ),
          modelFiles(take),
        ),
      );
    const newest = stored.map((each) => `${each.model}@${each.number}`);
    const chosen = (asked.models ?? "")
      .split(/[,\n]/)
      .filter(Boolean)
      .map((each) => (each.includes("@") ? each : (newest.find((one) => one.startsWith(`${each}@`)) ?? each)));
    if (!chosen.length && newest.length === 1) chosen.push(newest[0]);
    asked.models = chosen.join("\n");
    const names = [...new Set([...newest, ...chosen])];
    const known = { enum: names, titles: Object.fromEntries(names.map((each) => [each, each.replace("@", ", version ")])) };
    const models = { ...known, anyOf: [{ type: "array" }], label: "models, one an operating point" };
    question = questionForm(adapted(declared, ["export"], { models, joined: { ...known, anyOf: [{ type: "string" }] } }), asked, {
      first: ["models", modelFiles(take), ...FIRST],
      submit: h("button", { "data-key": "design" }, "Design"),
      onsubmit: () => begin({ again: true }),
    });
    return show(form, panel("Design for what, and how", null, question.form));
  }

  // A stored file of the same name gets a new version, which is then the one chosen.
  async function take(files) {
    try {
      for (const file of files) {
        const name = modelName(file.name);
        const version = await call(
          `/models?${new URLSearchParams({ name, kind: "identified", note: `from ${file.name}`.slice(0, 2000) })}`,
          { method: "POST", file },
        );
        const others = (asked.models ?? "").split("\n").filter((each) => each && !each.startsWith(`${name}@`));
        asked.models = [...others, `${name}@${version.number}`].join("\n");
      }
    } catch (problem) {
      notify(problem.message);
    }
    await readStored();
  }

  async function readStored() {
    declared ??= await fieldsOf("/control-designs/views");
    stored = (await call("/models?kind=identified&limit=200")).items;
    drawForm();
  }

  // A model of a simulated process first, as the page Identify makes it; then the design with the page's own wishes.
  const tryExample = () => simulateIn(result, PROCESS, identifyExample, leaving);
  const identifyExample = (record) =>
    runIn(
      result,
      "Identifying the simulated process",
      "/identify",
      { records: [record.id], input: "u", output: "y", save_as: "example" },
      async (model) => {
        asked.models = `${model.stored.model}@${model.stored.version}`;
        await readStored();
        begin({ again: true });
      },
      leaving,
    );

  const start = async () => {
    await readStored();
    if (query && asked.models && form.isConnected) begin();
    else if (form.isConnected) show(result, offer(HINT, "Try the example", tryExample));
  };
  start().catch((problem) => notify(problem.message));
  return () => {
    for (const each of leaving) each();
    for (const chart of place.querySelectorAll(".chart")) forget(chart);
  };
}

// Where the file goes that `residuum identify` wrote; `take` gets the chosen or dropped files.
function modelFiles(take) {
  const input = h("input", {
    type: "file",
    multiple: true,
    accept: ".json",
    class: "visually-hidden",
    id: "model-file",
    onchange: () => take([...input.files]).catch((problem) => notify(problem.message)),
  });
  const drop = h(
    "label",
    { class: "drop small", for: "model-file", "data-key": "model-drop" },
    h("span", {}, h("b", {}, "Drop a model file here"), " or choose one: what ", h("code", {}, "residuum identify"), " wrote"),
  );
  const over = (on) => (event) => {
    event.preventDefault();
    drop.toggleAttribute("data-over", on);
  };
  drop.addEventListener("dragover", over(true));
  drop.addEventListener("dragleave", over(false));
  drop.addEventListener("drop", (event) => {
    over(false)(event);
    take([...event.dataTransfer.files]).catch((problem) => notify(problem.message));
  });
  return h("div", { class: "field row" }, input, drop);
}

// `name@3` as the model and its version.
function versionOf(text) {
  const [model, version] = text.split("@");
  return { model, ...(Number(version) ? { version: Number(version) } : {}) };
}

// What an address asks. One that still tells the weight's order as `order` has the overshoot in percent.
function addressed(given) {
  const asked = Object.fromEntries([...given].map(([name, text]) => [EARLIER[name] ?? name, text]));
  if (given.has("order")) asked.overshoot = String(Number(asked.overshoot) / 100);
  if (given.get("lower") || given.get("upper")) asked.limits = `${given.get("lower") ?? ""},${given.get("upper") ?? ""}`;
  if (given.has("held")) asked.in_time = "true";
  return asked;
}

const seconds = (value) => (value === null ? "never" : quantity(value, "s"));

/** What the design promises in time beside what the nominal loop and drawn plants do. */
function promise({ promised, measured }) {
  const { nominal, random_plants: plants } = measured;
  return h(
    "p",
    {},
    `Promised: ${percent(promised.overshoot)} overshoot, settling in ${seconds(promised.settling_time_s)}. Measured on ` +
      `the nominal loop: ${nominal.overshoot === null ? "no end" : percent(nominal.overshoot)} and ` +
      `${seconds(nominal.settling_time_s)}${measured.kept ? ", kept" : ", NOT kept"}; ` +
      `${percent(measured.share_kept)} of ${plants.count} drawn plants keep it.`,
  );
}

const MOST_OF_A_UNIT = 24;

export const pointText = (view, point) =>
  view.aim === "nominal"
    ? `overshoot ${percent(point.first)}, settling in ${quantity(point.second, "s")}`
    : `gain ${number(point.first)} dB, frequency ${quantity(point.second, "rad/s")}`;

function drawDesign(place, view, limits, point, pick) {
  if (!view.feasible)
    return show(
      place,
      panel(
        "No such controller",
        null,
        h("p", { class: "says-large" }, `${capital(view.reason.replace(/^aim: /, ""))}.`),
        h(
          "p",
          { class: "muted" },
          view.aim === "nominal"
            ? "Ask for a longer settling time or more slack, allow another structure, or identify with more data: the " +
                "uncertainty reaches 100 % at "
            : "Allow another structure, or identify with more data: the uncertainty reaches 100 % at ",
          quantity(view.uncertainty.critical_frequency, "Hz"),
          ".",
        ),
      ),
    );
  const charts = {
    front: chart("Pareto front", "chart overlay"),
    steps: chart("Step responses of drawn plants", "chart overlay"),
    constraints: chart("Constraints of the design", "chart overlay"),
    loop: chart("Open loop with its range", "chart overlay"),
  };
  const parts = { says: h("div"), code: h("div") };
  const many = view.points.length > 1;
  const select = h(
    "select",
    { id: "point", "data-key": "point", onchange: () => choose(select.selectedIndex) },
    view.points.map((point) => h("option", {}, pointText(view, point))),
  );
  const part = (span, title, aside, ...content) =>
    h(
      "section",
      { class: `panel ${span}` },
      h("header", {}, h("h2", {}, title), aside ? h("div", { class: "aside" }, aside) : null),
      h("div", { class: "body" }, ...content),
    );
  show(
    place,
    parts.says,
    h(
      "div",
      { class: "columns" },
      part(
        "span-5",
        "Pareto front",
        many ? "click a point" : "one point",
        h("div", { class: "controls" }, h("label", { for: "point" }, "controller"), select),
        charts.front,
        many
          ? null
          : h(
              "p",
              { class: "muted small" },
              "No other point is on the front: whatever eases one wish makes the other worse, too.",
            ),
      ),
      part(
        "span-7",
        "Step responses",
        `${view.drawn_plants} plants drawn, ${view.points[0].steps.drawn.length} shown`,
        charts.steps,
        h(
          "p",
          { class: "muted small" },
          "Below: what the controller asks of the actuator, for a step of the reference by 1. ",
          limits.some(Number.isFinite) ? "Dotted: the actuator's limits, which no step that large may reach." : "",
        ),
      ),
    ),
    h(
      "div",
      { class: "columns" },
      part("span-6", "Constraints", "each line below its bound", charts.constraints),
      part("span-6", "Open loop", "range over the plants shown", charts.loop),
    ),
    parts.code,
  );

  function choose(index) {
    const point = view.points[index];
    select.selectedIndex = index;
    pick(index);
    show(parts.says, promises(view, point, index));
    show(parts.code, exportPanel(view, point));
    const drawing = [
      drawFront(charts.front, view, index, choose),
      drawSteps(charts.steps, view, point, limits),
      drawConstraints(charts.constraints, view, point),
      drawLoop(charts.loop, view, point),
    ];
    Promise.all(drawing).catch((problem) => notify(problem.message));
  }

  const wanted = Number(point ?? view.chosen);
  choose(wanted in view.points ? wanted : view.chosen);
}

const chart = (label, kind = "chart tall") => h("div", { class: kind, role: "figure", "aria-label": label });

function promises(view, point, index) {
  const fact = (name, value) => h("div", {}, h("dt", {}, name), h("dd", {}, value));
  const { figures } = point;
  const certified = point.robust_stability_norm !== null && point.robust_stability_norm < 1;
  const guarantee = certified
    ? `No plant within the uncertainty is destabilised: ‖W_T T‖∞ = ${number(point.robust_stability_norm)}, certified, below 1.`
    : `Plants with up to ${percent(1 / (point.robust_stability_norm ?? Infinity))} of the uncertainty are not ` +
      `destabilised: ‖W_T T‖∞ = ${number(point.robust_stability_norm)}, certified.`;
  const settled =
    figures.settling_time === null
      ? "most do not settle within the time followed"
      : `they settle in ${quantity(figures.settling_time, "s")} with ${percent(figures.overshoot)} overshoot (medians)`;
  return panel(
    "Controller",
    index === view.chosen ? "the preferred point of the front" : "another point of the front",
    index === view.chosen && view.promised ? promise(view) : null,
    h(
      "p",
      { class: "says-large" },
      guarantee,
      " ",
      `Of ${view.drawn_plants} plants drawn anew ${figures.unstable ? figures.unstable : "none"} became unstable; ${settled}.`,
    ),
    h(
      "dl",
      { class: "facts" },
      fact("K(z)", view.equation),
      Object.entries(point.parameters).map(([name, value]) => fact(name, quantity(value, parameterUnit(view, name)))),
      fact("Sample time", quantity(view.sample_time, "s")),
      fact("Cost", `${number(point.cost)} of ${number(view.limit)}, largest at ${quantity(point.worst_frequency, "Hz")}`),
    ),
  );
}

// [unit of u / unit of y], times or over seconds, by the parameter's meaning in the structure's equation.
function parameterUnit(view, name) {
  const [above, below] = [view.input.unit, view.output.unit].map((unit) => unitText(unit).slice(0, MOST_OF_A_UNIT));
  const gain = above || below ? `${above || "1"}${below ? `/${below.includes("/") ? `(${below})` : below}` : ""}` : "";
  if (name === "N_d") return "s";
  if (name === "k_i") return gain ? `${gain}/s` : "1/s";
  if (name === "k_d") return gain ? `${gain}·s` : "s";
  return name === "k_p" || name === "k" || name.startsWith("b_") ? gain : "";
}
