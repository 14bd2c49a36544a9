// What is known of the plant: read once, then kept current by events. Pages subscribe to it.

import { call, path } from "./api.js";
import { stateOf, worst } from "./parts.js";

const TREND = 60;
// Every item of a list that comes in pages.
export const all = async (address) => {
  const items = [];
  for (let cursor = null; ; ) {
    const page = await call(address + (cursor ? `${address.includes("?") ? "&" : "?"}cursor=${encodeURIComponent(cursor)}` : ""));
    items.push(...page.items);
    cursor = page.next_cursor;
    if (!cursor) return items;
  }
};

export const plant = {
  diagnosers: new Map(),
  assets: new Map(),
  alarms: new Map(),
  status: { machines: {}, sources: {} },
  trends: new Map(),
  listeners: new Set(),
};

// Whether the diagnoser of a machine has a picture of its own.
export const hasView = (asset, view) => plant.diagnosers.get(plant.assets.get(asset)?.diagnoser)?.views.includes(view) ?? false;

export function subscribe(listener) {
  plant.listeners.add(listener);
  return () => plant.listeners.delete(listener);
}

function tell(kind, payload) {
  for (const listener of plant.listeners) listener(kind, payload);
}

let reading = null; // the reading under way
let following = null; // the one that is asked for meanwhile: what is under way may be older than what it is asked for
let meanwhile = null; // events that came during the reading, which may be newer than what it found

export function readAll() {
  if (!reading) {
    reading = read().finally(() => {
      reading = null;
    });
    return reading;
  }
  following ??= reading
    .catch(() => {})
    .then(() => {
      following = null;
      return readAll();
    });
  return following;
}

async function read() {
  const came = [];
  meanwhile = came;
  try {
    const [assets, alarms, diagnosers] = await Promise.all([
      all("/assets?limit=500"),
      all("/alarms?limit=500"),
      all("/diagnosers"),
      readStatus(),
    ]);
    const trends = await Promise.all(
      assets.map((asset) => readTrend(asset.id).catch(() => [asset.id, plant.trends.get(asset.id) ?? []])),
    ); // no machine is missed for its trend
    plant.diagnosers = new Map(diagnosers.map((diagnoser) => [diagnoser.name, diagnoser]));
    plant.assets = new Map(assets.map((asset) => [asset.id, asset]));
    plant.alarms = new Map(alarms.map((alarm) => [alarm.id, alarm]));
    plant.trends = new Map(trends);
  } finally {
    meanwhile = null;
  }
  for (const [kind, payload] of came) apply(kind, payload);
  tell("all");
}

async function readTrend(asset) {
  const history = await call(`${path("assets", asset, "indicators")}?limit=${TREND}`);
  const points = history.windows.map((window, row) => {
    let largest = null;
    for (const [name, values] of Object.entries(history.indicators)) {
      const ratio = values[row] / history.thresholds[name]?.[row];
      if (Number.isFinite(ratio) && values[row] !== null && (largest === null || ratio > largest)) largest = ratio;
    }
    return { window, at: history.at[row], ratio: largest };
  });
  return [asset, points];
}

let statusAsked = 0;
let statusTaken = 0;

// The newest answer counts, in whatever order they come.
export async function readStatus() {
  const number = ++statusAsked;
  const status = await call("/status");
  if (number < statusTaken) return;
  statusTaken = number;
  plant.status = status;
  tell("status");
}

export function take(kind, payload) {
  meanwhile?.push([kind, payload]);
  if (kind === "reset" || (kind === "finding" && !plant.assets.has(payload.asset))) return readAll();
  apply(kind, payload);
  tell(kind, payload);
  return undefined;
}

// An event's part of the state; taking one twice changes nothing.
function apply(kind, payload) {
  if (kind === "finding") judged(payload);
  if (kind !== "alarm") return;
  if (payload.state === "normal") plant.alarms.delete(payload.id);
  else plant.alarms.set(payload.id, payload);
}

function judged(finding) {
  const known = plant.assets.get(finding.asset);
  if (!known) return;
  const trend = plant.trends.get(finding.asset) ?? [];
  if (!trend.some((point) => point.window === finding.window))
    plant.trends.set(finding.asset, [...trend, { window: finding.window, at: finding.at, ratio: worst(finding) }].slice(-TREND));
  if (known.last_finding?.window >= finding.window) return;
  Object.assign(known, { last_finding: finding, state: stateOf(finding), windows: known.windows + 1 });
}

// Every machine that is known, by its windows or by the pipeline: [asset, its state in the pipeline or undefined].
export function machinesOfPlant() {
  const watched = new Map(named(plant.status.machines));
  return [...new Set([...plant.assets.keys(), ...watched.keys()])]
    .sort((a, b) => a.localeCompare(b))
    .map((name) => [
      plant.assets.get(name) ?? { id: name, title: name, state: "no-data", last_finding: null },
      watched.get(name),
    ]);
}

// What a machine shows: that it failed goes before what was found of it once.
export function shownState(asset, machine) {
  if (machine?.state === "failed") return "failed";
  const unseen = !asset?.last_finding && ["training", "waiting"].includes(machine?.state);
  return unseen ? machine.state : (asset?.state ?? "no-data");
}

const GAPS = 4; // windows that may be late before a machine is no longer live
const AT_LEAST = 30; // seconds
const OF_THE_FIRST = 60; // seconds, while one window does not yet say how often they come

// Whether windows of a machine are judged now: nothing else is told of it, and the last is no older than a few of the usual gaps.
export function isLive(asset, machine) {
  const last = asset?.last_finding;
  if (!last || stateOf(last) === "no-baseline" || (machine && machine.state !== "running")) return false;
  const times = (plant.trends.get(asset.id) ?? []).map((point) => new Date(point.at) / 1000).sort((a, b) => a - b);
  const gaps = times
    .slice(1)
    .map((time, index) => time - times[index])
    .sort((a, b) => a - b);
  const usual = gaps.length ? gaps[Math.floor(gaps.length / 2)] : OF_THE_FIRST / GAPS;
  return Date.now() / 1000 - new Date(last.at) / 1000 <= Math.max(AT_LEAST, GAPS * usual);
}

export const named = (states) =>
  Array.isArray(states) ? states.map((state, index) => [state.name ?? String(index), state]) : Object.entries(states ?? {});

// The diagnoser that has this view.
export const diagnoserWith = (view) => [...plant.diagnosers].find(([, told]) => told.views.includes(view))?.[0];
