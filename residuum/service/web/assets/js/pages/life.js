// What became of a machine, on lanes below its trend and on the same axis of time: alarms from raised to gone, what was found
// at the machine, and which baseline and model judged from when on.

import { series, tones } from "../charts/charts.js";
import { call, path } from "../lib/api.js";
import { notify } from "../lib/dom.js";
import { moment, span } from "../lib/format.js";
import { all } from "../lib/plant_state.js";

const OUTCOMES = { confirmed: "it was so", corrected: "it was something else", refuted: "there was no such thing" };
const OUTCOME_SYMBOLS = { confirmed: "circle", corrected: "diamond", refuted: "x", damaged: "cross" };
const LANES = { alarms: "Alarms", found: "Found", models: "Models" };

export const NOTHING = { alarms: [], found: [], models: [] };

// Alarms, confirmations and versions of a period (`since` as a query, led by &).
export async function readLife(asset, since) {
  const of = `asset=${encodeURIComponent(asset)}`;
  try {
    const [alarms, found, accepted, stored] = await Promise.all([
      all(`/alarms/history?limit=500&${of}${since}`),
      all(`/confirmations?limit=500&${of}${since}`),
      call(path("assets", asset, "model")),
      all("/models?kind=baseline&limit=500"),
    ]);
    const baselines = stored.filter(({ model }) => model === asset || model === `${asset}.baseline`);
    const trained = await Promise.all(baselines.map(({ model }) => all(path("models", model, "versions"))));
    const begin = since ? new Date(new URLSearchParams(since).get("from")) : new Date(0);
    const models = [...accepted.history, ...trained.flat()].filter(({ created_at }) => new Date(created_at) >= begin);
    return { alarms, found, models };
  } catch (problem) {
    notify(problem.message);
    return NOTHING;
  }
}

// Plotly's traces for the lanes that have something in them, and the lanes' titles from the top.
export function lanes(life, local) {
  const drawn = Object.keys(LANES).filter((lane) => life[lane].length);
  const titles = drawn.map((lane) => LANES[lane]);
  const draws = { alarms: alarmTrace, found: foundTrace, models: modelTrace };
  return { titles, traces: drawn.map((lane) => ({ ...draws[lane](life[lane], local, LANES[lane]), yaxis: "y2" })) };
}

// A bar from raised to gone; one that stands reaches to now. The nulls part the bars.
function alarmTrace(alarms, local, lane) {
  const says = (each) => {
    const gone = each.cleared_at ? new Date(each.cleared_at) : new Date();
    const lasted = span((gone - new Date(each.raised_at)) / 1000);
    const ended = each.cleared_at ? `gone after ${lasted}` : `for ${lasted}, still there`;
    return `${each.kind === "signal" ? "signal" : "machine"}: ${ended}`;
  };
  return {
    type: "scatter",
    mode: "lines+markers",
    x: alarms.flatMap((each) => [local(each.raised_at), local(each.cleared_at ?? new Date().toISOString()), null]),
    y: alarms.flatMap(() => [lane, lane, null]),
    text: alarms.flatMap((each) => [says(each), says(each), ""]),
    line: { width: 7, color: tones().faulty },
    marker: { size: 7, symbol: "line-ns-open", color: tones().faulty },
    hovertemplate: "%{text}<extra></extra>",
  };
}

function foundTrace(found, local, lane) {
  const says = (each) => {
    const what = [OUTCOMES[each.outcome] ?? each.outcome, each.cause, each.part, each.order && `order ${each.order}`];
    return `window ${each.window}, ${what.filter(Boolean).join(", ")} (${each.who})`;
  };
  return {
    type: "scatter",
    mode: "markers",
    x: found.map((each) => local(each.found_at)),
    y: found.map(() => lane),
    text: found.map(says),
    marker: { size: 10, symbol: found.map(({ outcome }) => OUTCOME_SYMBOLS[outcome] ?? "cross"), color: series()[0] },
    hovertemplate: "%{text}<extra></extra>",
  };
}

function modelTrace(models, local, lane) {
  const says = ({ kind, number, created_by, created_at, note }) =>
    [`${kind} version ${number}, ${moment(created_at)}`, created_by && `by ${created_by}`, note].filter(Boolean).join(", ");
  return {
    type: "scatter",
    mode: "markers",
    x: models.map(({ created_at }) => local(created_at)),
    y: models.map(() => lane),
    text: models.map(says),
    marker: { size: 10, symbol: "square", color: series()[1] },
    hovertemplate: "%{text}<extra></extra>",
  };
}
