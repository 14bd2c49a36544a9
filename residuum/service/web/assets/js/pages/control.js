// Design a robust controller from identified models: what is possible, what it promises, how it behaves, code for the target.

import { forget } from "../charts/charts.js";
import { drawConstraints, drawFront, drawLoop, drawSteps } from "../charts/control_charts.js";
import { keptAddress } from "../lib/address.js";
import { call } from "../lib/api.js";
import { h, notify, panel, show } from "../lib/dom.js";
import { capital, number, percent, quantity, unitText } from "../lib/format.js";
import { runIn } from "../lib/jobs.js";
import { modelName } from "../lib/model_name.js";
import { offer, PROCESS, simulateIn } from "../steps/example.js";
import { WEIGHT, weightDetails, weightFields, weightParameters } from "../steps/weight_form.js";
import { exportPanel } from "./control_export.js";

const AIMS = { nominal: "nominal performance", robust: "robust performance" };
const STRUCTURES = {
  pidn: "PID with filtered derivative",
  pid: "PID",
  pi: "PI",
  "lead-lag": "lead–lag",
  rational: "rational, order 2",
};
const ONLY = {
  nominal: { "": "both wishes", overshoot: "least overshoot", "settling-time": "shortest settling" },
  robust: { "": "both wishes", "high-gain": "highest gain", "critical-frequency": "highest frequency" },
};
const ROBUST = ["lowGain", "highGain", "critical"];
const NOMINAL = ["overshoot", "settling", "slack", "held"];
const KEPT = ["models", "aim", "structure", "only", ...NOMINAL, ...ROBUST, "lower", "upper", ...Object.keys(WEIGHT), "point"];
const HELD = { "": "those of the weight", time: "held in time" };
const DEFAULTS = {
  models: "",
  aim: "nominal",
  structure: "pidn",
  overshoot: "1",
  settling: "",
  slack: "0.1",
  only: "",
  held: "",
  lowGain: "120",
  highGain: "-50",
  critical: "",
  lower: "",
  upper: "",
  ...WEIGHT,
};

const HINT =
  "Choose an identified model and press Design, or try a simulated process that is identified first. " +
  "The design shows what is possible, what is promised, and code to download.";

export function controlPage(place, query) {
  document.title = "Control · Residuum";
  const given = Object.fromEntries(new URLSearchParams(query ?? ""));
  const asked = { ...DEFAULTS, ...Object.fromEntries(KEPT.filter((key) => key in given).map((key) => [key, given[key]])) };
  for (const [key, known] of [
    ["aim", AIMS],
    ["structure", STRUCTURES],
    ["only", ONLY[asked.aim] ?? {}],
  ])
    if (!(asked[key] in known)) asked[key] = DEFAULTS[key];
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
  const save = () => keep(`#/control?${new URLSearchParams(KEPT.filter((key) => asked[key]).map((key) => [key, asked[key]]))}`);
  const pick = (point) => {
    asked.point = String(point);
    save();
  };

  function begin({ again = false } = {}) {
    if (again) delete asked.point;
    if (!asked.models) return notify("Choose a model first.");
    save();
    runIn(
      result,
      "Designing controllers along the front of what is possible",
      "/control-designs/views",
      body(asked),
      (view) => drawDesign(result, view, asked, pick),
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
    const chosen = new Set(
      asked.models
        .split(",")
        .filter(Boolean)
        .map((each) => (each.includes("@") ? each : (newest.find((one) => one.startsWith(`${each}@`)) ?? each))),
    );
    if (!chosen.size && newest.length === 1) chosen.add(newest[0]);
    const all = [...newest, ...[...chosen].filter((each) => !newest.includes(each))];
    const tell = () => {
      asked.models = all.filter((each) => chosen.has(each)).join(",");
    };
    tell();
    const rows = all.map((each) =>
      h(
        "label",
        { class: "choice" },
        h("input", {
          type: "checkbox",
          "data-key": `model-${each}`,
          checked: chosen.has(each),
          onchange: (event) => {
            chosen[event.target.checked ? "add" : "delete"](each);
            tell();
          },
        }),
        h("span", { class: "name", title: each }, each.replace("@", ", version ")),
      ),
    );
    const choose = (key, label, options, taken = () => {}) =>
      h(
        "label",
        {},
        label,
        h(
          "select",
          {
            "data-key": key,
            onchange: (event) => {
              asked[key] = event.target.value;
              taken();
            },
          },
          Object.entries(options).map(([value, text]) => h("option", { value, selected: value === asked[key] }, text)),
        ),
      );
    const type = (key, label, attributes) =>
      h(
        "label",
        {},
        label,
        h("input", {
          type: "number",
          step: "any",
          "data-key": key,
          value: asked[key],
          ...attributes,
          oninput: (event) => {
            asked[key] = event.target.value;
          },
        }),
      );
    const nominal = asked.aim === "nominal";
    show(
      form,
      panel(
        "Design for what, and how",
        null,
        h(
          "form",
          {
            class: "stack",
            onsubmit: (event) => {
              event.preventDefault();
              begin({ again: true });
            },
          },
          h(
            "fieldset",
            {},
            h("legend", {}, "models, one an operating point"),
            h("div", { class: "choices" }, rows),
            modelFiles(take),
          ),
          h(
            "div",
            { class: "fields" },
            choose("aim", "aim", AIMS, () => {
              asked.only = "";
              drawForm();
            }),
            choose("structure", "structure", STRUCTURES),
            asked.held && nominal ? null : choose("only", "of the front take", ONLY[asked.aim]),
            nominal
              ? choose("held", "overshoot and settling time are", HELD, () => {
                  asked.only = "";
                  drawForm();
                })
              : null,
            nominal ? type("overshoot", "least overshoot worth having [%]", { min: 0.001, max: 99, required: true }) : null,
            nominal ? type("settling", "longest settling time [s]", { min: 0, placeholder: "10 × the response" }) : null,
            nominal ? type("slack", "slack γ of the bound", { min: 0.001, max: 100, required: true }) : null,
            nominal ? null : type("lowGain", "gain l_g of W_S at low frequency [dB]", { min: 0.001, max: 400, required: true }),
            nominal
              ? null
              : type("highGain", "least gain h_g at high frequency [dB]", { min: -400, max: -0.501, required: true }),
            nominal
              ? null
              : type("critical", "least critical frequency ω_c [rad/s]", { min: 0, placeholder: "a thousandth of W_T's" }),
            type("lower", "actuator's lower limit", { placeholder: "none" }),
            type("upper", "actuator's upper limit", { placeholder: "none" }),
            h("button", { "data-key": "design" }, "Design"),
          ),
          weightDetails(weightFields(asked)),
        ),
      ),
    );
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
        asked.models = [
          ...asked.models.split(",").filter((each) => each && !each.startsWith(`${name}@`)),
          `${name}@${version.number}`,
        ].join(",");
      }
    } catch (problem) {
      notify(problem.message);
    }
    await readStored();
  }

  async function readStored() {
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

  let stored = [];
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
  return h("div", {}, input, drop);
}

function body(asked) {
  const models = asked.models.split(",").map((each) => {
    const [model, version] = each.split("@");
    return { model, ...(Number(version) ? { version: Number(version) } : {}) };
  });
  const optional = (key, name = key) =>
    asked[key] === "" || !Number.isFinite(Number(asked[key])) ? {} : { [name]: Number(asked[key]) };
  const bound = (text) => (text === "" || !Number.isFinite(Number(text)) ? null : Number(text));
  const wishes =
    asked.aim === "nominal"
      ? {
          overshoot: Number(asked.overshoot) / 100,
          slack: Number(asked.slack),
          ...(asked.held ? { in_time: true } : {}),
          ...optional("settling", "settling_time"),
        }
      : {
          ...optional("lowGain", "low_gain"),
          ...optional("highGain", "high_gain"),
          ...optional("critical", "critical_frequency"),
        };
  return {
    models,
    aim: asked.aim,
    structure: asked.structure,
    ...wishes,
    ...weightParameters(asked),
    ...(asked.only ? { only: asked.only } : {}),
    limits: [bound(asked.lower), bound(asked.upper)],
  };
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

function drawDesign(place, view, asked, pick) {
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
  const limits = [asked.lower, asked.upper].map((each) => (each === "" ? null : Number(each)));
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

  const wanted = Number(asked.point ?? view.chosen);
  choose(wanted in view.points ? wanted : view.chosen);
}

const chart = (label, kind = "chart tall") => h("div", { class: kind, role: "img", "aria-label": label });

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
