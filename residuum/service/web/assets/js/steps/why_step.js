// Step 4: which effect is missing? Ranked candidates with sizes, their curves over the cloud, and what would tell more.

import { blockErrorsChart, drawBlockErrors } from "../charts/block_errors.js";
import { cloudChart, drawCloud } from "../charts/cloud.js";
import { call } from "../lib/api.js";
import { h, notify, panel, show } from "../lib/dom.js";
import { effectTitle } from "../lib/effect_titles.js";
import { capital, localised, number, percent, quantity, unitText } from "../lib/format.js";
import { run, runIn } from "../lib/jobs.js";
import { badge, placed } from "../lib/parts.js";
import { tableHead } from "../lib/table_head.js";
import { optionsOf } from "./options.js";
import { naturalAxis } from "./where_step.js";

const LISTED = 8;
const LIKELY = 0.5;
const WORTH_SAYING = 0.1;
const DRAWN = 4;
const VERDICTS = {
  "missing-effect": ["faulty", "An effect is missing"],
  adequate: ["healthy", "The model is adequate"],
  "unknown-effect": ["not-assessable", "Something outside the catalogue"],
};

export async function whyStep(place, bench) {
  const body = h("div", { class: "stack" });
  show(place, body);
  const options = await optionsOf(bench, "explain", () => bench.go("why"));
  if (!body.isConnected) return undefined; // the step has been left
  place.append(options.form);
  const work = async (explanation, signal) => {
    const titles = new Map((await call("/effects", { signal })).items.map((each) => [each.effect, each]));
    drawExplanation(body, bench, explanation, titles);
  };
  return runIn(body, "Finding out what is missing", bench.address("explain"), options.body(), work, bench.leaving);
}

// `0.0602 ± 0.0004 N*m`: the value to the digit that its deviation leaves.
export function measured({ value, std, unit }) {
  const shown = unitText(unit) ? ` ${unitText(unit)}` : "";
  if (!(std > 0) || !Number.isFinite(value)) return `${number(value)}${shown}`;
  if (std < 1e-7 * Math.abs(value) || std < 1e-5) return `${number(value)} ± ${number(Number(std.toPrecision(2)))}${shown}`;
  const digits = Math.min(8, Math.max(1, Math.ceil(Math.log10(Math.abs(value) / std) + 1.5)));
  const rounded = (figure, kept) => figure.toLocaleString(undefined, { maximumSignificantDigits: kept });
  return `${Number.isFinite(digits) ? rounded(value, digits) : number(value)} ± ${rounded(std, 2)}${shown}`;
}

// Values that the record plainly contradicts, each beside the model file's.
function otherValues(explanation) {
  return (explanation.estimated_values ?? [])
    .filter((each) => each.differs)
    .map((each) => `${each.name} = ${measured(each)} (the model file says ${number(each.file)})`);
}

// What an adequate model is told: with other values than the file's it may only explain the record.
function adequate(explanation) {
  const values = otherValues(explanation);
  return values.length
    ? `No effect is missing: with other values the model explains the record. ${values.join(", ")}.`
    : "No effect of the catalogue is needed to explain the record.";
}

function drawExplanation(body, bench, explanation, effects) {
  const candidates = explanation.candidates.slice(0, LISTED);
  // Each effect of a joint answer has its row: what is missing besides the first is no less missing.
  const besides = explanation.also_missing.filter((each) => each.probability >= WORTH_SAYING);
  const [tone, word] = VERDICTS[explanation.verdict] ?? ["idle", explanation.verdict];
  const leading = candidates[0];
  const named =
    leading && explanation.verdict === "missing-effect"
      ? `${effects.get(leading.effect)?.title ?? leading.effect} in ${leading.balance}`
      : null;
  const places = { blocks: h("div"), cloud: h("div") };
  show(
    body,
    h(
      "div",
      { class: "verdict" },
      badge(tone, word),
      h(
        "p",
        { class: "says-large" },
        named
          ? headline(named, leading, effects) + andBesides(besides, effects)
          : explanation.verdict === "adequate"
            ? adequate(explanation)
            : "The structured error has a shape that no effect of the catalogue makes.",
      ),
      explanation.verdict === "missing-effect"
        ? h(
            "button",
            {
              type: "button",
              class: "quiet",
              "data-key": "auto",
              onclick: () => bench.go("add", { shown: { ...bench.shown, auto: true } }),
            },
            "Add automatically",
          )
        : null,
      explanation.verdict === "unknown-effect" && !bench.shown.explain?.learned
        ? h(
            "button",
            {
              type: "button",
              class: "quiet",
              "data-key": "learn",
              title: "Search again, with curves that are learned over one signal among the candidates",
              onclick: () => bench.go("why", { shown: { ...bench.shown, explain: { ...bench.shown.explain, learned: "true" } } }),
            },
            "Try learned curves",
          )
        : null,
    ),
    panel(
      "Candidates",
      `nothing missing ${percent(explanation.probability_nothing_missing)} · something unknown ` +
        `${percent(explanation.probability_unknown_effect)}`,
      candidates.length
        ? ranking(candidates, besides, effects, bench)
        : h("p", { class: "empty" }, "No effect of the catalogue lowers the error."),
    ),
    notes(explanation, effects),
    places.blocks,
    places.cloud,
    advice(explanation, effects),
  );
  if (explanation.blocks) drawErrors(places.blocks, bench, explanation.blocks, effects);
  drawCurves(places.cloud, bench, [...candidates, ...besides]).catch((problem) => {
    if (problem.name !== "AbortError") notify(problem.message);
  });
}

// The formula that a term outside the catalogue resembles, as a sentence; nothing where there is none.
function looksLike({ suggestion: formula, unit, axis }) {
  if (!formula) return "";
  return ` It looks like ${localised(formula.formula)} ${unitText(unit)}, z = ${axis} ÷ ${number(formula.largest)}.`;
}

const asMuchAs = ({ as_much_as: effects }) =>
  effects.length ? `as much as ${effects.map(placed).join(" and ")}` : "more than an effect would";

// What else the record says: further effects, terms outside the catalogue, drift, and how the record was taken.
function notes(explanation, effects) {
  const titled = (id) => effects.get(id)?.title ?? id;
  const term = explanation.missing_term;
  const said = [
    ...(term && explanation.probability_unknown_effect > WORTH_SAYING
      ? [
          `A term outside the catalogue in ${term.balance}, a function of ${term.axis}, explains ` +
            `${percent(explanation.unexplained_share)} of what can be explained.${looksLike(term)}`,
        ]
      : []),
    ...explanation.held_values.map(
      (each) =>
        `${each.name} is fixed at ${number(each.held)} ${unitText(each.unit)}; the record asks for ${measured(each)}, which ` +
        `explains ${asMuchAs(each)}.`,
    ),
    ...(explanation.verdict === "adequate"
      ? []
      : otherValues(explanation).map((text) => `Estimated from the record with these effects: ${text}.`)),
    ...(explanation.drifting ? ["An unknown load or offset drifts with time; it explains more than any effect would."] : []),
    ...explanation.timing.map((each) => `${titled(each.effect)} at ${each.at} by less than a sample: how the record was taken.`),
  ];
  return said.length
    ? panel(
        "What else the record says",
        null,
        h(
          "ul",
          { class: "plain" },
          said.map((text) => h("li", {}, text)),
        ),
      )
    : null;
}

function ranking(candidates, besides, effects, bench) {
  const heads = ["Effect", "Probability", "Size", "Error, before → after", ""];
  const row = (candidate, index) =>
    h(
      "tr",
      {},
      h(
        "td",
        { "data-label": heads[0], class: "wide" },
        h(
          "div",
          {},
          h("b", {}, effects.get(candidate.effect)?.title ?? candidate.effect),
          index < candidates.length ? null : h("span", { class: "small" }, " besides the first"),
          h("div", { class: "muted small" }, `in ${candidate.balance}: ${effects.get(candidate.effect)?.equation ?? ""}`),
          candidate.rivals.length
            ? h("div", { class: "small" }, `This record cannot tell it from ${candidate.rivals.map(placed).join(", ")}.`)
            : null,
          candidate.within_bounds ? null : h("div", { class: "small" }, "At a physical bound."),
        ),
      ),
      h(
        "td",
        { "data-label": heads[1], class: "number" },
        h(
          "div",
          {},
          percent(candidate.probability),
          h(
            "span",
            { class: "meter", role: "img", "aria-label": `probability ${percent(candidate.probability)}` },
            h("i", { style: { width: `${Math.max(1, 100 * candidate.probability)}%` } }),
          ),
        ),
      ),
      h(
        "td",
        { "data-label": heads[2] },
        h(
          "div",
          {},
          Object.entries(candidate.parameters).map(([name, value]) =>
            h("div", { class: "number small" }, `${name} = ${measured(value)}`),
          ),
        ),
      ),
      h(
        "td",
        { "data-label": heads[3] },
        h(
          "div",
          {},
          h(
            "div",
            { class: "number" },
            `${quantity(candidate.error_before, candidate.error_unit)} → ` +
              `${quantity(candidate.error_after, candidate.error_unit)}`,
          ),
          h("div", { class: "muted small" }, `of ${candidate.output}${candidate.held_out ? ", on data kept aside" : ""}`),
        ),
      ),
      h(
        "td",
        { "data-label": heads[4] },
        h(
          "button",
          {
            type: "button",
            class: index ? "quiet" : null,
            "data-key": `add-${index}`,
            "aria-label": `Add ${effectTitle(candidate.effect)} to ${candidate.balance}`,
            onclick: () =>
              bench.go("add", {
                shown: {
                  ...bench.shown,
                  add: {
                    effect: candidate.effect,
                    balance: candidate.balance,
                    parameters: Object.fromEntries(
                      Object.entries(candidate.parameters).map(([name, each]) => [name, each.value]),
                    ),
                  },
                },
              }),
          },
          "Add",
        ),
      ),
    );
  return h(
    "div",
    { class: "scroll" },
    h(
      "table",
      { class: "reflow" },
      tableHead([...heads.slice(0, 4), h("span", { class: "visually-hidden" }, "Action")], [1]),
      h("tbody", {}, [...candidates, ...besides].map(row)),
    ),
  );
}

// When the model fails, and what each candidate would take away there.
function drawErrors(place, bench, blocks, effects) {
  const names = blocks.outputs.map((each) => each.output);
  const name = names.includes(bench.shown.output) ? bench.shown.output : names[0];
  const chart = blockErrorsChart(`Error of ${name} on unseen blocks`);
  const again = (chosen) => {
    bench.show({ output: chosen });
    drawErrors(place, bench, blocks, effects);
  };
  const controls = names.length > 1 ? h("div", { class: "controls" }, choice("output", names, name, again)) : null;
  show(
    place,
    h(
      "section",
      { class: "panel" },
      h("header", {}, h("h2", {}, "Error over time, on blocks that no fit has seen"), controls),
      h("div", { class: "body" }, chart),
    ),
  );
  return drawBlockErrors(chart, blocks, name, effects);
}

// One of several names; `choose` is told the chosen one.
function choice(label, values, value, choose) {
  const onchange = (event) => choose(values[event.target.selectedIndex]);
  const options = values.map((each) => h("option", { selected: each === value }, each));
  return h("label", {}, label, h("select", { "data-key": label, onchange }, options));
}

async function drawCurves(place, bench, candidates) {
  const stop = new AbortController();
  bench.leaving.push(() => stop.abort());
  const view = await run(bench.address("views"), (await optionsOf(bench, "views")).body(), { signal: stop.signal });
  const balances = view.points.terms.filter((term) => term.kind === "balance").map((term) => term.of);
  const fitting = candidates.filter((candidate) => balances.includes(candidate.balance)).slice(0, DRAWN);
  if (!fitting.length || !place.isConnected) return;
  const effects = fitting.map(({ effect, balance, parameters }) => ({
    effect,
    balance,
    parameters: Object.fromEntries(Object.entries(parameters).map(([name, each]) => [name, each.value])),
  }));
  const { curves } = await run(bench.address("effect-curves"), { ...bench.asked, effects }, { signal: stop.signal });
  if (!place.isConnected) return;
  const drawPanel = () => {
    const balance = balances.includes(bench.shown.balance) ? bench.shown.balance : fitting[0].balance;
    const axes = view.points.axes.map((axis) => axis.name);
    const axis = axes.includes(bench.shown.axis) ? bench.shown.axis : naturalAxis(view);
    const chart = cloudChart(`Candidates in ${balance} against ${axis}`);
    const choose = (label, values, value, key) =>
      choice(label, values, value, (chosen) => {
        bench.show({ [key]: chosen });
        drawPanel();
      });
    show(
      place,
      h(
        "section",
        { class: "panel" },
        h(
          "header",
          {},
          h("h2", {}, "Candidates over what is missing"),
          h("div", { class: "controls" }, choose("balance", balances, balance, "balance"), choose("against", axes, axis, "axis")),
        ),
        h("div", { class: "body" }, chart),
      ),
    );
    drawCloud(chart, view, balance, axis, { curves: curves.filter((curve) => curve.balance === balance && curve.axis === axis) });
  };
  drawPanel();
}

// A group that the record cannot tell apart is named as one: the first of it is no likelier than the others.
function headline(named, leading, effects) {
  const alike = leading.rivals.map((id) => effects.get(id.split("@")[0])?.title ?? id);
  if (!alike.length) return `Most probably ${named}, ${percent(leading.probability)}.`;
  const together = Math.min(1, leading.probability * (1 + alike.length));
  return `Most probably ${named} or ${alike.join(" or ")}, together ${percent(together)}: this record cannot tell them apart.`;
}

// The other effects of a joint answer.
function andBesides(besides, effects) {
  const likely = besides.filter((each) => each.probability >= LIKELY);
  const named = likely.map(
    (each) => `${effects.get(each.effect)?.title ?? each.effect} in ${each.balance}, ${percent(each.probability)}`,
  );
  return named.length ? ` Besides it ${named.join("; ")}.` : "";
}

function advice(explanation, effects) {
  const hidden = explanation.undetectable.map((each) =>
    h("li", {}, `${effects.get(each.effect)?.title ?? each.effect} in ${each.balance}: ${visible(each)}`),
  );
  const next = explanation.next_experiment.map((each) =>
    h("li", {}, `${capital(each.do)}: tells ${each.separates.join(" from ")} in ${percent(each.power)} of the cases.`),
  );
  return h(
    "div",
    { class: "columns" },
    h(
      "section",
      { class: "panel span-6" },
      h("header", {}, h("h2", {}, "Next experiment")),
      h(
        "div",
        { class: "body" },
        next.length
          ? h("ul", { class: "plain" }, next)
          : h("p", { class: "empty" }, "Nothing more is needed to tell the candidates apart."),
      ),
    ),
    h(
      "section",
      { class: "panel span-6" },
      h("header", {}, h("h2", {}, "What this record could not have shown")),
      h(
        "div",
        { class: "body" },
        hidden.length
          ? h("details", {}, h("summary", {}, `${hidden.length} effects`), h("ul", { class: "plain" }, hidden))
          : h("p", { class: "empty" }, "Every effect that fits would have been seen."),
      ),
    ),
  );
}

// The least size that would have shown: one number, or one a parameter.
function visible({ smallest_visible: least, unit }) {
  const sizes =
    least !== null && typeof least === "object"
      ? Object.entries(least).map(([name, value]) => `${name} = ${quantity(value, unit)}`)
      : [quantity(least, unit)];
  return `below ${sizes.join(", ")} it would not show.`;
}
