// Identify a linear model from a record: impulse and frequency response with their confidence.

import { draw, forget, series } from "../charts/charts.js";
import { keptAddress } from "../lib/address.js";
import { call, path } from "../lib/api.js";
import { h, notify, panel, show } from "../lib/dom.js";
import { number, percent, quantity, unitText } from "../lib/format.js";
import { runIn } from "../lib/jobs.js";
import { offer, PROCESS, simulateIn } from "../steps/example.js";
import { uploadedRecords } from "../steps/record_step.js";
import { checkPanels } from "./model_checks.js";
import { compareModels } from "./model_comparison.js";
import { trustPanels } from "./trust.js";

const METHODS = {
  kernel: "kernel-based impulse response",
  ridge: "impulse response, ridge",
  lasso: "impulse response, lasso",
  "elastic-net": "impulse response, elastic net",
  "set-membership": "impulse response, set membership",
  "stochastic-embedding": "stochastic embedding",
  arx: "ARX",
  fir: "FIR",
  armax: "ARMAX",
  oe: "output error",
  bj: "Box–Jenkins",
};
const UNCERTAINTIES = {
  own: "covariance of the estimate",
  "model-error": "model error model",
  "set-membership": "set membership",
  "stochastic-embedding": "stochastic embedding",
};
const KEPT = ["record", "input", "output", "method", "order", "also", "uncertainty", "bound", "name", "watch", "offset"];

const HINT =
  "Choose a record's input and output and press Identify, or try a simulated process. " +
  "The model comes with its uncertainty; Control designs a controller from it.";

export function identifyPage(place, query) {
  document.title = "Identify · Residuum";
  const asked = Object.fromEntries(new URLSearchParams(query ?? ""));
  const form = h("div");
  const compared = h("div");
  const result = h("div", { class: "stack" });
  const leaving = [];
  show(
    place,
    h(
      "div",
      { class: "title" },
      h("h1", {}, "Identify and design"),
      h("p", { class: "muted about" }, "A linear model from one input to one output, with its uncertainty."),
    ),
    panel("Inputs and outputs", null, form),
    compared,
    result,
  );

  const keep = keptAddress();
  const save = () => keep(`#/identify?${new URLSearchParams(KEPT.filter((key) => asked[key]).map((key) => [key, asked[key]]))}`);

  const bench = {
    leaving,
    records: [],
    get watch() {
      return asked.watch;
    },
    get offset() {
      return asked.offset;
    },
    get healthy() {
      return asked.record;
    },
    set: (change) => {
      Object.assign(asked, change);
      save();
    },
  };

  const orders = () =>
    (asked.order ?? "")
      .split(/[\s,;]+/)
      .map(Number)
      .filter((order) => order > 0);
  const bodyOf = (method, order) => ({
    records: [Number(asked.record)],
    input: asked.input,
    output: asked.output,
    method,
    save_as: asked.name,
    check: true,
    ...(order ? { order } : {}),
    uncertainty: asked.uncertainty,
    ...([asked.uncertainty, method].includes("set-membership") && Number(asked.bound)
      ? { noise_bound: Number(asked.bound) }
      : {}),
  });

  function begin() {
    save();
    const methods = [asked.method, ...also().filter((method) => method !== asked.method)];
    const wanted = methods.flatMap((method) =>
      (orders().length ? orders() : [null]).map((order) => ({
        title: `${METHODS[method]}${order ? `, order ${order}` : ""}`,
        body: bodyOf(method, order),
      })),
    );
    if (wanted.length === 1) {
      show(compared);
      const [{ body }] = wanted;
      return runIn(result, "Identifying", "/identify", body, (model, signal) => drawModel(result, model, bench, signal), leaving);
    }
    show(result);
    const shown = (model) => drawModel(result, model, bench, undefined).catch((problem) => notify(problem.message));
    return compareModels(compared, wanted, shown, leaving);
  }

  const also = () => (asked.also ?? "").split(",").filter((method) => method in METHODS);

  // Other methods that are to be identified by, too, and compared.
  function otherMethods() {
    const tick = (method, on) => {
      asked.also = [...also().filter((each) => each !== method), ...(on ? [method] : [])].join(",");
    };
    return h(
      "details",
      { open: also().length > 0 },
      h("summary", { "data-key": "compare-methods" }, "Compare with other methods"),
      h(
        "div",
        { class: "controls" },
        Object.entries(METHODS).map(([method, title]) =>
          h(
            "label",
            {},
            h("input", {
              type: "checkbox",
              "data-key": `also-${method}`,
              checked: also().includes(method),
              onchange: (event) => tick(method, event.target.checked),
            }),
            title,
          ),
        ),
      ),
    );
  }

  function drawForm() {
    const { records } = bench;
    if (!records.length)
      return show(
        form,
        h("p", { class: "empty" }, "No record yet: ", h("a", { href: "#/workbench" }, "drop one on the workbench"), "."),
      );
    const record = records.find((each) => each.id === Number(asked.record)) ?? records[0];
    const channels = Object.keys(record.units);
    asked.record = String(record.id);
    if (!channels.includes(asked.input)) asked.input = channels[0];
    if (!channels.includes(asked.output)) asked.output = channels.find((name) => name !== asked.input) ?? channels[0];
    asked.method ??= "kernel";
    asked.uncertainty ??= "own";
    asked.name ??= "identified";
    const choose = (key, label, options) =>
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
              if (["record", "uncertainty", "method"].includes(key)) drawForm();
            },
          },
          options.map(([value, text]) => h("option", { value, selected: value === asked[key] }, text)),
        ),
      );
    const type = (key, label, attributes) =>
      h(
        "label",
        {},
        label,
        h("input", {
          "data-key": key,
          value: asked[key] ?? "",
          ...attributes,
          oninput: (event) => {
            asked[key] = event.target.value;
          },
        }),
      );
    show(
      form,
      h(
        "form",
        {
          class: "fields",
          onsubmit: (event) => {
            event.preventDefault();
            begin();
          },
        },
        choose(
          "record",
          "record",
          records.map((each) => [String(each.id), `${each.id} · ${each.name.slice(0, 60)}`]),
        ),
        choose(
          "input",
          "input",
          channels.map((name) => [name, name.slice(0, 60)]),
        ),
        choose(
          "output",
          "output",
          channels.map((name) => [name, name.slice(0, 60)]),
        ),
        choose("method", "method", Object.entries(METHODS)),
        type("order", "order (empty: chosen; several: 1, 2, 4)", { pattern: "[0-9,; ]*", inputmode: "numeric" }),
        choose("uncertainty", "uncertainty from", Object.entries(UNCERTAINTIES)),
        [asked.uncertainty, asked.method].includes("set-membership")
          ? type("bound", "largest noise (empty: 1.1 × least)", { type: "number", step: "any", min: 0 })
          : null,
        type("name", "store as", { pattern: "[A-Za-z0-9][A-Za-z0-9._\\-]{0,63}", required: true }),
        h("button", {}, "Identify"),
      ),
      otherMethods(),
    );
  }

  const tryExample = () =>
    simulateIn(
      result,
      PROCESS,
      (record) => {
        bench.records.unshift(record);
        Object.assign(asked, { record: String(record.id), input: "u", output: "y", name: "example" });
        drawForm();
        begin();
      },
      leaving,
    );

  const start = async () => {
    bench.records = await uploadedRecords();
    drawForm();
    if (query && asked.record && form.isConnected) begin();
    else if (form.isConnected) show(result, offer(HINT, "Try the example", tryExample));
  };
  start().catch((problem) => notify(problem.message));
  return () => {
    for (const each of leaving) each();
    for (const chart of place.querySelectorAll(".chart")) forget(chart);
  };
}

async function drawModel(place, model, bench, signal) {
  const response = await call(`${path("models", model.stored.model, "frequency-response")}?version=${model.stored.version}`, {
    signal,
  });
  const impulse = h("div", { class: "chart", role: "img", "aria-label": "Impulse response" });
  const bode = h("div", { class: "chart overlay", role: "img", "aria-label": "Bode diagram" });
  const fits = (values) => values.map((fit) => (fit === null ? "–" : percent(fit / 100))).join(", ");
  const fact = (name, value) => h("div", {}, h("dt", {}, name), h("dd", {}, value));
  show(
    place,
    panel(
      "Model",
      `stored as ${model.stored.model}, version ${model.stored.version}`,
      h(
        "dl",
        { class: "facts" },
        fact("Method", model.model),
        model.denominator
          ? fact("Order", number(model.denominator.length - 1))
          : fact("Impulse response", `${number(model.order)} coefficients`),
        fact("Delay", `${model.delay} samples`),
        fact("Fit", fits(model.fit_percent)),
        model.held_out_fit_percent.length ? fact("Held-out fit", fits(model.held_out_fit_percent)) : null,
        fact("Noise", `${quantity(Math.sqrt(model.noise_variance), model.output.unit)} standard deviation`),
      ),
      model.warnings.map((text) => h("p", { class: "small" }, text)),
    ),
    h(
      "div",
      { class: "columns" },
      h(
        "section",
        { class: "panel span-6" },
        h("header", {}, h("h2", {}, "Impulse response"), h("div", { class: "aside" }, "± 2 standard deviations")),
        h("div", { class: "body" }, impulse),
      ),
      h(
        "section",
        { class: "panel span-6" },
        h("header", {}, h("h2", {}, "Frequency response"), h("div", { class: "aside" }, "± 2 standard deviations")),
        h("div", { class: "body" }, bode),
      ),
    ),
    checkPanels(model),
    trustPanels(model, bench),
  );
  drawImpulse(impulse, model);
  drawBode(bode, model, response);
}

function band(x, low, high, colour, more = {}) {
  return {
    type: "scatter",
    mode: "lines",
    x: [...x, ...x.toReversed()],
    y: [...high, ...low.toReversed()],
    fill: "toself",
    fillcolor: `${colour}38`,
    line: { width: 0 },
    hoverinfo: "skip",
    ...more,
  };
}

const gainUnit = ({ input, output }) => `${unitText(output.unit) || "1"} / ${unitText(input.unit) || "1"}`;

function drawImpulse(place, model) {
  const [colour] = series();
  const lag = model.impulse_response.map((_, index) => (index + model.delay) * model.sample_time);
  const shifted = (times) => model.impulse_response.map((value, index) => value + times * (model.std[index] ?? 0));
  return draw(
    place,
    [
      band(lag, shifted(-2), shifted(2), colour),
      {
        type: "scatter",
        mode: "lines+markers",
        x: lag,
        y: model.impulse_response,
        line: { color: colour, width: 1.5 },
        marker: { size: 4 },
        hovertemplate: "%{x:.4~g} s<br>%{y:.4~g}<extra></extra>",
      },
    ],
    {
      x: { title: { text: "lag [s]" }, exponentformat: "SI" },
      y: { title: { text: `g [${gainUnit(model)}]` }, exponentformat: "SI" },
    },
  );
}

function drawBode(place, model, { frequency, magnitude, magnitude_std: spread, phase, phase_std: turn }) {
  const [blue, orange] = series();
  const least = Math.max(...magnitude) * 1e-6;
  const low = magnitude.map((value, index) => Math.max(value - 2 * spread[index], least));
  const line = (y, colour, more) => ({
    type: "scatter",
    mode: "lines",
    x: frequency,
    y,
    line: { color: colour, width: 1.8 },
    hovertemplate: "%{x:.4~g} Hz<br>%{y:.4~g}<extra></extra>",
    ...more,
  });
  const lower = { yaxis: "y2" };
  return draw(
    place,
    [
      band(
        frequency,
        low,
        magnitude.map((value, index) => value + 2 * spread[index]),
        blue,
      ),
      line(magnitude, blue),
      band(
        frequency,
        phase.map((value, index) => value - 2 * Math.min(turn[index], 360)),
        phase.map((value, index) => value + 2 * Math.min(turn[index], 360)),
        orange,
        lower,
      ),
      line(phase, orange, lower),
    ],
    {
      x: { title: { text: "frequency [Hz]" }, type: "log", anchor: "y2" },
      y: { title: { text: `magnitude [${gainUnit(model)}]` }, type: "log", exponentformat: "SI", domain: [0.48, 1] },
      y2: { title: { text: "phase [°]" }, domain: [0, 0.4] },
    },
  );
}
