// Step 5: add the effect, see the error fall, compare versions, undo, download.

import { draw, series } from "../charts/charts.js";
import { overlay } from "../charts/overlay.js";
import { call, path } from "../lib/api.js";
import { h, notify, panel, show } from "../lib/dom.js";
import { effectTitle } from "../lib/effect_titles.js";
import { percent, quantity } from "../lib/format.js";
import { run, runIn } from "../lib/jobs.js";
import { badge } from "../lib/parts.js";
import { download } from "../lib/report_file.js";
import { tableHead } from "../lib/table_head.js";
import { acceptancePanel } from "./acceptance.js";
import { structured } from "./compare_step.js";
import { describe, modelTitle } from "./models.js";
import { optionsOf } from "./options.js";

const NARROW = 520; // pixels
const SPANS_DECADES = 30; // largest over least error, from which on bars of one length scale hide the small ones

export async function addStep(place, bench) {
  const body = h("div", { class: "stack" });
  show(place, body);
  const { add, auto } = bench.shown;
  if (!add && !auto) return drawModel(body, bench);
  const { add: _, auto: __, ...shown } = bench.shown;
  const begin = () => {
    const title = add
      ? `Adding ${effectTitle(add.effect)} to ${add.balance}, and estimating all parameters`
      : "Adding what is missing until the model is adequate";
    runIn(body, title, bench.address(noun), { ...options.body(), ...(add ? { add } : {}) }, done, bench.leaving);
  };
  const done = (result) => {
    if (!result.stored) return drawRefused(body, bench, result, shown);
    bench.go("add", {
      base: bench.base ?? key(bench.model, bench.version),
      model: result.stored.model,
      version: result.stored.version,
      shown: { ...shown, before: key(bench.model, bench.version), ...(result.verdict ? { ended: result.verdict } : {}) },
    });
  };
  const noun = add ? "effects" : "improve";
  const save_as = {
    default: bench.version ? bench.model : `${bench.model}-mended`.slice(0, 64),
    label: "store as a new version of",
    required: true,
  };
  const learned = { default: bench.shown.explain?.learned === "true" };
  const options = await optionsOf(bench, noun, begin, {
    first: ["save_as"],
    submit: add ? "Add and estimate" : "Add automatically",
    without: add ? ["add"] : ["auto"],
    known: { save_as, ...(add ? {} : { learned }) },
  });
  const says = add
    ? [
        h("b", {}, effectTitle(add.effect)),
        ` is added to ${add.balance} of ${modelTitle(bench.model, bench.version)}. All free parameters are estimated ` +
          `again from the first 70 % of each record; the error is told on the rest.`,
      ]
    : [
        `Effects that explain the error are added to ${modelTitle(bench.model, bench.version)} one after the other, as ` +
          `long as its error on data kept aside falls.`,
      ];
  const back = h("button", { type: "button", class: "quiet", onclick: () => bench.go("why", { shown }) }, "Back");
  show(
    body,
    panel(add ? "Add an effect" : "Add automatically", null, h("div", { class: "stack" }, h("p", {}, says), options.form, back)),
  );
}

// Nothing was stored: all that has a name would make the model worse.
function drawRefused(body, bench, result, shown) {
  show(
    body,
    panel(
      "Nothing was added",
      `the error on data kept aside is ${quantity(result.history[0].error, result.error_unit)}`,
      h("p", {}, `${result.refused.join(", ")} would raise it. The model stays as it was, and no version was stored.`),
      h("button", { type: "button", "data-key": "back", onclick: () => bench.go("why", { shown }) }, "Back"),
    ),
  );
}

const key = (model, version) => (version ? `${model}@${version}` : model);
const unkey = (text) => {
  const [model, version] = text.split("@");
  return { model, version: Number(version) || null };
};

async function drawModel(body, bench) {
  const description = await describe(bench.model, bench.version);
  const stored = bench.version ? (await call(path("models", bench.model, "versions"))).items : [];
  if (!body.isConnected) return; // the step has been left
  const made = description.effects.filter(({ provenance }) => provenance.with_effect || provenance.error_after !== undefined);
  const versions = stored.map((each) => key(each.model, each.number));
  const all = [...new Set([key(bench.model, bench.version), ...versions, ...(bench.base ? [bench.base] : [])])];
  const before = all.includes(bench.shown.before) ? bench.shown.before : (previous(bench, versions) ?? bench.base);
  const overlaid = h("div");
  const bars = h("div", { class: "chart", role: "figure", "aria-label": "Error after every effect" });
  const undo = previous(bench, versions) ?? bench.base;
  show(
    body,
    h(
      "div",
      { class: "verdict" },
      h(
        "p",
        { class: "says-large" },
        made.length
          ? history(made) + (bench.shown.ended === "unknown-effect" ? " What is left has no name in the catalogue." : "")
          : `${modelTitle(bench.model, bench.version)} has no effect that was added here yet.`,
      ),
      undo
        ? h(
            "button",
            {
              type: "button",
              class: "quiet",
              "data-key": "undo",
              onclick: () => bench.go("add", { ...unkey(undo), shown: { ...bench.shown, before: null } }),
            },
            "Undo",
          )
        : null,
      h(
        "button",
        {
          type: "button",
          class: "quiet",
          "data-key": "download",
          onclick: () =>
            download(`${bench.model}${bench.version ? `-${bench.version}` : ""}.yaml`, description.file, "application/yaml"),
        },
        "Download the model file",
      ),
      h(
        "button",
        { type: "button", "data-key": "again", onclick: () => bench.go("why") },
        made.length ? "What else is missing?" : "Which effect is missing?",
      ),
    ),
    made.length
      ? panel(
          "Error after every effect",
          made.every(({ provenance }) => provenance.held_out ?? true)
            ? "on data that was not used for the estimation"
            : "on the data of the estimation",
          bars,
        )
      : null,
    h(
      "section",
      { class: "panel" },
      h(
        "header",
        {},
        h("h2", {}, "Before and after"),
        h(
          "div",
          { class: "controls" },
          versionSelect("before", all, before, (value) => {
            bench.show({ before: value });
            drawModel(body, bench);
          }),
          h("span", { class: "muted" }, `after: ${modelTitle(bench.model, bench.version)}`),
        ),
      ),
      h("div", { class: "body" }, overlaid),
    ),
    acceptancePanel(bench),
    description.effects.length ? panel("Effects of this model", null, effectTable(description.effects)) : null,
  );
  if (made.length) drawBars(bars, made, Object.fromEntries(description.outputs.map((each) => [each.name, each.unit])));
  drawOverlay(overlaid, bench, before).catch((problem) => {
    if (problem.name !== "AbortError") notify(problem.message);
  });
}

// The version before the present one, else what the work began with.
function previous(bench, versions) {
  const index = versions.indexOf(key(bench.model, bench.version));
  return versions[index + 1] ?? (bench.base === key(bench.model, bench.version) ? null : bench.base);
}

const versionSelect = (label, values, value, take) =>
  h(
    "label",
    {},
    label,
    h(
      "select",
      { "data-key": label, onchange: (event) => take(event.target.value) },
      values.map((each) =>
        h("option", { value: each, selected: each === value }, modelTitle(unkey(each).model, unkey(each).version)),
      ),
    ),
  );

// What each effect was added at: errors by output, before and after, whichever way it was added.
function stages({ provenance: of }) {
  if (of.with_effect)
    return {
      first: [
        ["as given", of.as_given],
        ["parameters estimated", of.re_estimated],
      ],
      after: of.with_effect,
    };
  return { first: [["as it was", { [of.output]: of.error_before }]], after: { [of.output]: of.error_after } };
}

function steps(made) {
  return [...stages(made[0]).first, ...made.map((effect) => [`+ ${effectTitle(effect.effect)}`, stages(effect).after])];
}

// Outputs whose error is known at the first and at the last step.
const followed = (all) => Object.keys(all[0][1]).filter((output) => Number.isFinite(all.at(-1)[1][output]));

function history(made) {
  const all = steps(made);
  const parts = followed(all).map((output) => `${output} ${percent(1 - all.at(-1)[1][output] / all[0][1][output])}`);
  return parts.length ? `The error fell by: ${parts.join(", ")}.` : `${made.map((effect) => effect.title).join(", ")}: added.`;
}

// Bars side by side, or below each other where there is no room for their numbers.
function drawBars(place, made, units) {
  const all = steps(made);
  const colours = series();
  const narrow = place.clientWidth < NARROW;
  const share = (output) => all.map(([, errors]) => (output in errors ? (100 * errors[output]) / all[0][1][output] : null));
  const names = all.map(([name]) => (narrow ? name.replace(/(?<=\w) /, "<br>") : name));
  const turned = (output) => (narrow ? { orientation: "h", x: share(output), y: names } : { x: names, y: share(output) });
  const traces = Object.keys(all[0][1]).map((output, index) => ({
    type: "bar",
    name: output,
    ...turned(output),
    customdata: share(output),
    text: all.map(([, errors]) => (output in errors ? quantity(errors[output], units[output]) : "")),
    textposition: "outside",
    constraintext: "none",
    cliponaxis: false,
    marker: { color: colours[index % 4], pattern: { shape: ["", "/", "x", "."][index % 4] } },
    hovertemplate: "%{customdata:.3~g} % of the first error<extra></extra>",
  }));
  const figures = {
    title: { text: "error [% of the first]" },
    ...scale(
      traces.flatMap((trace) => trace.customdata),
      narrow,
    ),
  };
  const category = { type: "category", ...(narrow ? { autorange: "reversed" } : {}) };
  return draw(place, traces, {
    x: narrow ? figures : category,
    y: narrow ? category : figures,
    more: {
      barmode: "group",
      showlegend: true,
      legend: { orientation: "h", y: 1.05, yanchor: "bottom", x: 0 },
      margin: { l: 64, r: 12, t: 40, b: 42 },
    },
  });
}

// The axis of the bars: by length, or by factors where they span decades; with room for the numbers beside them.
function scale(shares, narrow) {
  const positive = shares.filter((share) => share > 0);
  const [least, largest] = [Math.min(...positive), Math.max(...positive)];
  if (largest / least < SPANS_DECADES) return { range: [0, largest * (narrow ? 1.5 : 1.15)] };
  const [low, high] = [Math.log10(least) - 0.5, Math.log10(largest)];
  return { type: "log", range: [low, high + (high - low) * (narrow ? 0.5 : 0.15)], tickformat: "~g", dtick: 1 };
}

async function drawOverlay(place, bench, before) {
  show(place, h("p", { class: "loading" }, "Simulating …"));
  const stop = new AbortController();
  bench.leaving.push(() => stop.abort());
  const { version: _, ...asked } = (await optionsOf(bench, "views")).body();
  const of = ({ model, version }) =>
    run(path("models", model, "views"), { ...asked, ...(version ? { version } : {}) }, { signal: stop.signal });
  const current = { model: bench.model, version: bench.version };
  const [after, old] = [
    await of(current),
    before && before !== key(current.model, current.version) ? await of(unkey(before)) : null,
  ];
  if (!place.isConnected) return;
  const outputs = Object.keys(after.comparison.outputs);
  const output = outputs.includes(bench.shown.output) ? bench.shown.output : outputs[0];
  const record = Math.min(bench.shown.record ?? 0, after.signals.length - 1);
  const models = [
    { record: after.signals[record], label: "after" },
    ...(old ? [{ record: old.signals[record], label: "before", dash: "dot" }] : []),
  ];
  const [tone, word, sentence] = structured(after.comparison);
  const numbers = (view) => (view ? quantity(view.comparison.outputs[output].rmse, view.comparison.outputs[output].unit) : "–");
  const pick =
    outputs.length < 2
      ? null
      : h(
          "label",
          { class: "controls" },
          "output",
          h(
            "select",
            {
              "data-key": "overlay-output",
              onchange: (event) => {
                bench.show({ output: outputs[event.target.selectedIndex] });
                drawOverlay(place, bench, before);
              },
            },
            outputs.map((each) => h("option", { selected: each === output }, each)),
          ),
        );
  show(
    place,
    h(
      "div",
      { class: "controls" },
      pick,
      h(
        "span",
        { class: "muted" },
        `RMS error of the whole record: ${old ? `${numbers(old)} before, ` : ""}${numbers(after)}${old ? " after" : ""}`,
      ),
    ),
    overlay(output, after.comparison.outputs[output].unit, models, {}),
    h("div", { class: "verdict" }, badge(tone, word), h("p", {}, sentence)),
  );
}

function effectTable(effects) {
  const heads = ["Effect", "Where", "Equation", "Parameters"];
  return h(
    "div",
    { class: "scroll" },
    h(
      "table",
      { class: "reflow" },
      tableHead(heads),
      h(
        "tbody",
        {},
        effects.map((effect) =>
          h(
            "tr",
            {},
            h("td", { "data-label": heads[0] }, effect.title),
            h("td", { "data-label": heads[1] }, effect.target),
            h("td", { "data-label": heads[2] }, effect.equation),
            h(
              "td",
              { "data-label": heads[3] },
              h(
                "div",
                {},
                effect.parameters.map((each) => h("div", {}, `${each.name} = ${quantity(each.value, each.unit)}`)),
              ),
            ),
          ),
        ),
      ),
    ),
  );
}
