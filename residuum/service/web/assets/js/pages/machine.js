// One machine: the finding in words, indicators against thresholds over time, windows with signal and spectrum, alarms.

import { h, panel, refresh, show } from "../lib/dom.js";
import { effectTitle } from "../lib/effect_titles.js";
import { assetTitle, count, number, quantity, title } from "../lib/format.js";
import { badge, meter, methodsSay, ranked, saidOf, sentence } from "../lib/parts.js";
import { hasView, named, plant, shownState, subscribe } from "../lib/plant_state.js";
import { tableHead } from "../lib/table_head.js";
import { activeModel } from "../steps/acceptance.js";
import { methodChoice } from "../steps/deciding_method.js";
import { alarmList } from "./alarms.js";
import { causesPanel } from "./causes.js";
import { faultPanel } from "./faults.js";
import { featurePanels } from "./features.js";
import { freshness, progress, wayOn } from "./plant.js";
import { sourceTable } from "./sources.js";
import { tracksPanel } from "./tracks.js";
import { trendPanel } from "./trend.js";
import { windowsPanel } from "./windows.js";

export function machinePage(place, name, query) {
  const places = {
    head: h("div"),
    method: h("div"),
    now: h("div"),
    evidence: h("div"),
    alarms: h("div"),
    sources: h("div"),
    faults: h("div"),
    model: h("div"),
  };
  const features = featurePanels(name);
  const trend = trendPanel(name, features.update);
  const causes = causesPanel(name);
  let looked = null; // the finding of the window that was chosen
  const drawCauses = () => causes.update(looked ?? plant.assets.get(name)?.last_finding ?? null);
  const asked = Number(new URLSearchParams(query ?? "").get("window"));
  const windows = windowsPanel(name, asked > 0 ? asked : null, (finding) => {
    looked = finding;
    drawCauses();
  });
  const tracks = hasView(name, "tracks") ? tracksPanel(name) : null;
  const now = h(
    "section",
    { class: "panel span-7" },
    h("header", {}, h("h2", {}, "Indicators of the last window")),
    h("div", { class: "body" }, places.now),
  );
  const right = h(
    "div",
    { class: "span-5 stack" },
    places.faults,
    panel("Alarms", h("a", { href: `#/alarms?asset=${encodeURIComponent(name)}` }, "History"), places.alarms),
  );
  show(
    place,
    places.head,
    places.method,
    h("div", { class: "columns" }, now, right),
    causes.element,
    trend.element,
    tracks?.element ?? null,
    features.element,
    windows.element,
    panel("Sources", null, places.sources),
    places.model,
  );
  methodChoice(places.method, name);
  if (plant.assets.has(name))
    activeModel(name).then((element) => (element ? show(places.model, element) : places.model.remove()));
  document.title = `${assetTitle({ id: name })} · Residuum`;
  if (new Map(named(plant.status.machines)).get(name)?.simulated)
    faultPanel(name).then((element) => (element ? show(places.faults, element) : places.faults.remove()));
  else places.faults.remove();

  let judged; // the finding that is shown: drawn once, so that its evidence stays open
  const drawNow = (finding) => {
    if (finding === judged) return;
    judged = finding;
    refresh(places.now, () => (finding ? indicatorTable(finding) : h("p", { class: "empty" }, "Nothing has been judged yet.")));
  };
  const draw = () => {
    const asset = plant.assets.get(name);
    const machine = new Map(named(plant.status.machines)).get(name);
    show(places.head, head(name, asset, machine));
    drawNow(asset?.last_finding ?? null);
    drawCauses();
    refresh(places.alarms, () =>
      alarmList(
        [...plant.alarms.values()].filter((alarm) => alarm.asset === name),
        { withAsset: false },
      ),
    );
  };
  const drawSources = () => show(places.sources, sourceTable(sourcesOf(name)));
  const leave = subscribe((kind, payload) => {
    if (kind === "status") drawSources();
    if (kind === "finding" && payload.asset === name) {
      trend.add(payload);
      windows.add(payload);
    }
    if ((kind === "alarm" || kind === "confirmation" || kind === "model-accepted") && payload.asset === name) trend.live();
    if (kind === "all") {
      trend.read();
      windows.read();
    }
    draw();
  });
  const ticking = setInterval(draw, 5000);
  draw();
  drawSources();
  return () => {
    leave();
    clearInterval(ticking);
    trend.leave();
    features.leave();
    causes.leave();
    tracks?.leave();
    windows.leave();
  };
}

function head(name, asset, machine) {
  const finding = asset?.last_finding;
  const busy = machine?.state === "training";
  const state = shownState(asset, machine);
  return h(
    "div",
    {},
    h(
      "div",
      { class: "title" },
      h("h1", {}, assetTitle(asset ?? { id: name })),
      badge(state, finding?.class && state === "faulty" ? `Faulty: ${effectTitle(finding.class)}` : undefined),
    ),
    busy ? progress(machine) : null,
    h("p", { class: "says-large" }, saidOf(finding, machine)),
    wayOn(name, machine),
    machine?.state === "recording"
      ? h(
          "p",
          {},
          h("a", { href: `#/watch?${new URLSearchParams({ machine: name, step: "healthy" })}` }, "Choose the windows and train"),
        )
      : null,
    h(
      "dl",
      { class: "facts" },
      fact("Diagnoser", asset?.diagnoser ?? machine?.diagnoser ?? "–"),
      ...methods(finding),
      finding?.ne107 ? fact("NE 107", title(finding.ne107), "What somebody is to do, in the categories of NAMUR NE 107") : null,
      fact("Judged last", finding ? freshness(asset, machine) : "none yet"),
      fact("Windows kept", count(asset?.windows ?? 0)),
    ),
  );
}

const methods = (finding) =>
  methodsSay(finding).map(({ name, says, decides, reason }) => fact(name, `${says}${decides ? " (decides)" : ""}`, reason));

const fact = (name, value, hint) => h("div", { title: hint }, h("dt", {}, name), h("dd", {}, value));

export function indicatorTable(finding) {
  const rows = ranked(finding);
  if (!rows.length) return h("p", { class: "empty" }, "This finding has no indicators: ", sentence(finding));
  return h(
    "div",
    { class: "scroll" },
    h(
      "table",
      { class: "reflow" },
      tableHead(["Indicator", "Value", "Threshold", "Value ÷ threshold"], [1, 2]),
      h(
        "tbody",
        {},
        rows.map((row) =>
          h(
            "tr",
            {},
            h("td", { "data-label": "Indicator" }, title(row.name)),
            h(
              "td",
              { "data-label": "Value", class: `number${row.above ? " above" : ""}` },
              quantity(row.value, row.unit, row.threshold),
            ),
            h("td", { "data-label": "Threshold", class: "number" }, quantity(row.threshold, row.unit, row.value)),
            h(
              "td",
              { "data-label": "Value ÷ threshold" },
              row.ratio === null
                ? h(
                    "span",
                    { class: "muted" },
                    !Number.isFinite(row.threshold) ? "not judged alone" : row.above ? "above" : "below",
                  )
                : h(
                    "div",
                    {},
                    h("span", { class: "number small" }, `${number(row.ratio)}${row.above ? " – above" : ""}`),
                    meter(row),
                  ),
            ),
          ),
        ),
      ),
    ),
    evidence(finding),
  );
}

function evidence(finding) {
  if (!Object.keys(finding.evidence ?? {}).length) return null;
  return h(
    "details",
    {},
    h("summary", {}, "Evidence"),
    h("pre", { tabindex: 0 }, JSON.stringify(finding.evidence, shortened, 1)),
  );
}

const shortened = (_, value) =>
  Array.isArray(value) && value.length > 24
    ? `[${value.length} values, first ${number(value[0])}, last ${number(value.at(-1))}]`
    : value;

function sourcesOf(name) {
  const own = named(plant.status.sources).filter(
    ([source, state]) => (state.asset ?? state.machine) === name || source.startsWith(name),
  );
  return Object.fromEntries(own);
}
