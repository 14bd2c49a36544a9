// Every time that an alarm was raised: what of which machine, how bad, how long, and what was said of it.

import { keptAddress } from "../lib/address.js";
import { h, notify, panel, refresh, show } from "../lib/dom.js";
import { assetTitle, moment, number, span } from "../lib/format.js";
import { badge, said } from "../lib/parts.js";
import { periods, since } from "../lib/periods.js";
import { all, machinesOfPlant, plant, subscribe } from "../lib/plant_state.js";
import { tableHead } from "../lib/table_head.js";
import { alarmList } from "./alarms.js";

const HEADS = ["Raised", "Machine", "What", "Times its threshold", "Lasted", "Acknowledged"];
const STATES = {
  "": ["any state", () => true],
  standing: ["still there", (each) => !each.cleared_at],
  cleared: ["gone again", (each) => each.cleared_at],
  unseen: ["never acknowledged", (each) => !each.acknowledged_at],
};
// What stands and nobody has seen comes first, a machine's fault before a signal's, the furthest above its threshold
// before others.
const urgency = (each) =>
  [!each.cleared_at, !each.acknowledged_at, each.kind === "machine", each.times_threshold ?? 0].map(Number);
const lasted = (each) => (each.cleared_at ? new Date(each.cleared_at) : Date.now()) - new Date(each.raised_at);
const firstDifference = (a, b) => a.map((value, index) => b[index] - value).find(Boolean) ?? 0;
const ORDERS = {
  "": ["newest first", (a, b) => b.id - a.id],
  urgent: ["most urgent first", (a, b) => firstDifference(urgency(a), urgency(b)) || b.id - a.id],
  longest: ["longest first", (a, b) => lasted(b) - lasted(a)],
};
const FEW = 100; // rows drawn until more are asked for
const KEPT = ["asset", "state", "order", "period"];

export function alarmHistoryPage(place, query) {
  document.title = "Alarms · Residuum";
  const given = new URLSearchParams(query ?? "");
  const asked = Object.fromEntries(KEPT.map((key) => [key, given.get(key) ?? (key === "period" ? "week" : "")]));
  const now = h("div");
  const controls = h("div", { class: "controls" });
  const list = h("div");
  const keep = keptAddress();
  let raised = [];
  let shown = FEW;
  let reading = 0;
  const history = h(
    "section",
    { class: "panel" },
    h("header", {}, h("h2", {}, "History"), controls),
    h("div", { class: "body" }, list),
  );
  show(place, h("div", { class: "title" }, h("h1", {}, "Alarms")), panel("On the list now", null, now), history);

  const ofMachine = (alarm) => !asked.asset || alarm.asset === asked.asset;
  const drawNow = () => {
    const standing = [...plant.alarms.values()].filter(ofMachine);
    refresh(now, () => alarmList(standing));
  };
  const draw = () => {
    const rows = raised.filter((STATES[asked.state] ?? STATES[""])[1]).sort((ORDERS[asked.order] ?? ORDERS[""])[1]);
    const more = () => {
      shown += FEW;
      draw();
    };
    refresh(list, () => [
      rows.length ? table(rows.slice(0, shown)) : h("p", { class: "empty" }, "No alarm was raised in this period."),
      rows.length > shown
        ? h("p", { class: "next" }, h("button", { type: "button", class: "quiet", onclick: more }, `Show more of ${rows.length}`))
        : null,
    ]);
  };
  async function read() {
    const mine = ++reading;
    const of = asked.asset ? `&asset=${encodeURIComponent(asked.asset)}` : "";
    try {
      const found = await all(`/alarms/history?limit=500${of}${since(asked.period)}`);
      if (mine !== reading || !list.isConnected) return;
      raised = found;
      draw();
    } catch (problem) {
      notify(problem.message);
    }
  }
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
            keep(`#/alarms?${new URLSearchParams(KEPT.map((each) => [each, asked[each]]))}`);
            drawNow();
            read();
          },
        },
        options.map(([value, text]) => h("option", { value, selected: value === asked[key] }, text)),
      ),
    );
  const named = (choices) => Object.entries(choices).map(([value, [text]]) => [value, text]);
  const drawControls = () => {
    const machines = machinesOfPlant().map(([asset]) => [asset.id, assetTitle(asset)]);
    show(
      controls,
      choose("asset", "machine", [["", "all machines"], ...machines]),
      choose("state", "state", named(STATES)),
      choose("order", "order", named(ORDERS)),
      choose("period", "raised in the", periods("whole time")),
    );
  };
  const leave = subscribe((kind) => {
    if (kind === "all") drawControls();
    if (kind !== "alarm" && kind !== "all") return;
    drawNow();
    read();
  });
  drawControls();
  drawNow();
  read();
  return leave;
}

function table(rows) {
  return h("div", { class: "scroll" }, h("table", { class: "reflow" }, tableHead(HEADS, [3]), h("tbody", {}, rows.map(row))));
}

function row(each) {
  const machine = `#/machines/${encodeURIComponent(each.asset)}`;
  const says = [each.acknowledged_by ? `by ${each.acknowledged_by}, ${moment(each.acknowledged_at)}` : "no", ...each.comments];
  const cells = [
    moment(each.raised_at),
    h("a", { href: machine }, each.asset),
    h(
      "div",
      {},
      each.kind === "signal" ? "Signal: " : "",
      each.message ? said(each.message) : "What was found then is no longer kept.",
      each.window
        ? [" ", h("a", { class: "small", href: `${machine}?window=${each.window}` }, `See window ${each.window}`)]
        : null,
    ),
    number(each.times_threshold),
    each.cleared_at ? span(lasted(each) / 1000) : badge("unacknowledged", `${span(lasted(each) / 1000)}, still there`),
    h(
      "div",
      {},
      says.map((line) => h("div", {}, line)),
    ),
  ];
  return h(
    "tr",
    {},
    cells.map((cell, index) => h("td", { "data-label": HEADS[index], class: { 2: "wide", 3: "number" }[index] }, cell)),
  );
}
