// Identify a linear model from a record: impulse and frequency response with their confidence.

import { draw, forget, series } from "../charts/charts.js";
import { keptAddress } from "../lib/address.js";
import { call, path } from "../lib/api.js";
import { h, notify, panel, show } from "../lib/dom.js";
import { number, percent, quantity, title, unitText } from "../lib/format.js";
import { runIn } from "../lib/jobs.js";
import { adapted, fieldsOf, questionForm } from "../lib/question_form.js";
import { offer, PROCESS, simulateIn } from "../steps/example.js";
import { recordTitles, uploadedRecords } from "../steps/record_step.js";
import { checkPanels } from "./model_checks.js";
import { compareModels } from "./model_comparison.js";
import { trustPanels } from "./trust.js";

// What the address named otherwise once.
const EARLIER = { bound: "noise_bound", name: "save_as" };
const PROPOSED = { save_as: { default: "identified", required: true }, check: { default: true } };
const ALSO = {
  type: "array",
  label: "compare with other methods",
  description: "Identify by these, too, and show them side by side.",
};
const SEVERAL_ORDERS = { anyOf: [{ type: "array" }], label: "order (empty: chosen; several: 1, 2, 4)" };

const HINT =
  "Choose a record's input and output and press Identify, or try a simulated process. " +
  "The model comes with its uncertainty; Control designs a controller from it.";

export function identifyPage(place, query) {
  document.title = "Identify · Residuum";
  const given = [...new URLSearchParams(query ?? "")];
  const asked = Object.fromEntries(given.map(([name, text]) => [EARLIER[name] ?? name, text]));
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
  const save = () => keep(`#/identify?${new URLSearchParams(Object.entries(asked).filter(([, text]) => text))}`);
  const bench = {
    asked,
    leaving,
    records: [],
    set: (change) => {
      Object.assign(asked, change);
      save();
    },
  };
  let question = null;
  let declared = null;

  // What is to be identified: a request for each method and order.
  function wanted() {
    const { method, also = [] } = question.body();
    return [method, ...also.filter((each) => each !== method)].flatMap((each) => {
      const {
        record: _,
        also: __,
        order: orders = [null],
        further_records: more = [],
        ...said
      } = question.body({ method: each });
      return orders.map((order) => ({
        title: `${title(each)}${order ? `, order ${order}` : ""}`,
        body: { ...said, records: [...new Set([asked.record, ...more])].map(Number), ...(order ? { order: Number(order) } : {}) },
      }));
    });
  }

  function begin() {
    save();
    const all = wanted();
    if (all.length === 1) {
      show(compared);
      const [{ body }] = all;
      return runIn(result, "Identifying", "/identify", body, (model, signal) => drawModel(result, model, bench, signal), leaving);
    }
    show(result);
    const shown = (model) => drawModel(result, model, bench, undefined).catch((problem) => notify(problem.message));
    return compareModels(compared, all, shown, leaving);
  }

  function drawForm() {
    const { records } = bench;
    if (!records.length)
      return show(
        form,
        h("p", { class: "empty" }, "No record yet: ", h("a", { href: "#/workbench" }, "drop one on the workbench"), "."),
      );
    const record = records.find((each) => each.id === Number(asked.record)) ?? records[0];
    asked.record = String(record.id);
    const channels = Object.keys(record.units);
    const input = channels.includes(asked.input) ? asked.input : channels[0];
    const ofRecord = { anyOf: [{ type: "string" }], enum: channels, titles: shortened(channels), required: true };
    const named = { enum: records.map((each) => String(each.id)), titles: recordTitles(records) };
    const fields = {
      record: { type: "string", required: true, ...named },
      ...adapted(declared, ["records"], {
        input: { ...ofRecord, default: channels[0] },
        output: { ...ofRecord, default: channels.find((name) => name !== input) ?? channels[0] },
        order: { ...declared.order, ...SEVERAL_ORDERS },
        ...PROPOSED,
      }),
      further_records: { type: "array", description: "Further experiments with the same plant.", ...named },
      also: { ...ALSO, enum: declared.method.enum },
    };
    question = questionForm(fields, asked, {
      first: ["record", "input", "output", "method", "order", "uncertainty", "noise_bound", "save_as"],
      submit: h("button", {}, "Identify"),
      onsubmit: begin,
      changed: (name) => name === "record" && drawForm(),
    });
    return show(form, question.form);
  }

  const tryExample = () =>
    simulateIn(
      result,
      PROCESS,
      (record) => {
        bench.records.unshift(record);
        Object.assign(asked, { record: String(record.id), input: "u", output: "y", save_as: "example" });
        drawForm();
        begin();
      },
      leaving,
    );

  const start = async () => {
    [bench.records, declared] = await Promise.all([uploadedRecords(), fieldsOf("/identify")]);
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

const shortened = (names) => Object.fromEntries(names.map((name) => [name, name.slice(0, 60)]));

async function drawModel(place, model, bench, signal) {
  const response = await call(`${path("models", model.stored.model, "frequency-response")}?version=${model.stored.version}`, {
    signal,
  });
  const impulse = h("div", { class: "chart", role: "figure", "aria-label": "Impulse response" });
  const bode = h("div", { class: "chart overlay", role: "figure", "aria-label": "Bode diagram" });
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
