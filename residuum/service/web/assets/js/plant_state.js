// What is known of the plant: read once, then kept current by events. Pages subscribe to it.

import { call, path } from "./api.js";
import { worst } from "./parts.js";

const TREND = 60;
const all = async (address) => {
  const items = [];
  for (let cursor = null; ;) {
    const page = await call(address + (cursor ? `${address.includes("?") ? "&" : "?"}cursor=${encodeURIComponent(cursor)}` : ""));
    items.push(...page.items);
    cursor = page.next_cursor;
    if (!cursor) return items;
  }
};

export const plant = { assets: new Map(), alarms: new Map(), status: { machines: {}, sources: {} }, trends: new Map(), listeners: new Set() };

export function subscribe(listener) {
  plant.listeners.add(listener);
  return () => plant.listeners.delete(listener);
}

const tell = (kind, payload) => plant.listeners.forEach((listener) => listener(kind, payload));

export async function readAll() {
  const [assets, alarms] = await Promise.all([all("/assets?limit=500"), all("/alarms?limit=500"), readStatus()]);
  plant.assets = new Map(assets.map((asset) => [asset.id, asset]));
  plant.alarms = new Map(alarms.map((alarm) => [alarm.id, alarm]));
  await Promise.all(assets.map((asset) => readTrend(asset.id)));
  tell("all");
}

async function readTrend(asset) {
  const history = await call(`${path("assets", asset, "indicators")}?limit=${TREND}`);
  const ratios = history.at.map((_, row) => {
    let largest = null;
    for (const [name, values] of Object.entries(history.indicators)) {
      const ratio = values[row] / history.thresholds[name]?.[row];
      if (Number.isFinite(ratio) && values[row] !== null && (largest === null || ratio > largest)) largest = ratio;
    }
    return largest;
  });
  plant.trends.set(asset, ratios);
}

export async function readStatus() {
  plant.status = await call("/status");
  tell("status");
}

export function take(kind, payload) {
  if (kind === "finding") {
    const known = plant.assets.get(payload.asset);
    if (!known) return readAll();
    known.last_finding = payload;
    known.state = payload.verdict;
    known.windows += 1;
    plant.trends.set(payload.asset, [...(plant.trends.get(payload.asset) ?? []), worst(payload)].slice(-TREND));
  } else if (kind === "alarm") {
    if (payload.state === "normal") plant.alarms.delete(payload.id);
    else plant.alarms.set(payload.id, payload);
  } else if (kind === "reset") return readAll();
  tell(kind, payload);
  return undefined;
}

export const named = (states) => (Array.isArray(states) ? states.map((state, index) => [state.name ?? String(index), state]) : Object.entries(states ?? {}));
