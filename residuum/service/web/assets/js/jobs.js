// Long work: send a request that becomes a job, show its progress, end it on demand; finished results are remembered.

import { call, path } from "./api.js";
import { h, show } from "./dom.js";

const results = new Map();
const PAUSE = 300;

// Waits between two looks at a job; throws at once when the signal has been or becomes aborted.
const pause = (signal) => new Promise((resolve, reject) => {
  signal?.throwIfAborted();
  const stop = () => { clearTimeout(timer); reject(signal.reason); };
  const timer = setTimeout(() => { signal?.removeEventListener("abort", stop); resolve(); }, PAUSE);
  signal?.addEventListener("abort", stop, { once: true });
});

// Resolves with the job's result; `onProgress` is told each state. An aborted signal cancels the job.
export function run(address, body, { onProgress = () => {}, signal, fresh = false } = {}) {
  const key = `${address} ${JSON.stringify(body)}`;
  if (fresh || !results.has(key)) {
    const work = follow(address, body, onProgress, signal);
    const forget = () => { if (results.get(key) === work) results.delete(key); };
    results.set(key, work);
    signal?.addEventListener("abort", forget, { once: true });
    work.then(() => signal?.removeEventListener("abort", forget), forget);
  }
  return results.get(key);
}

async function follow(address, body, onProgress, signal) {
  let job = await call(address, { method: "POST", body });
  const own = path("jobs", job.id);
  try {
    while (job.state === "queued" || job.state === "running") {
      onProgress(job);
      await pause(signal);
      job = await call(own);
      signal?.throwIfAborted(); // asked to stop while the answer was on its way
    }
  } catch (problem) {
    if (problem.name === "AbortError") await call(own, { method: "DELETE" });
    throw problem;
  }
  if (job.state !== "done") throw new Error(job.error ?? `The work was ${job.state}.`);
  return job.result;
}

// Shows the job's progress in `place` with a button that cancels it, then what `draw` makes of the result.
export async function runIn(place, title, address, body, draw, leaving, { fresh = false } = {}) {
  const stop = new AbortController();
  leaving.push(() => stop.abort());
  const bar = h("i", { style: { width: "0%" } });
  const doing = h("p", { class: "muted small" }, "waiting");
  const progress = h("div", { class: "progress", role: "progressbar", "aria-label": title, "aria-valuemin": 0, "aria-valuemax": 100, "aria-valuenow": 0 }, bar);
  show(place, h("div", { class: "working", role: "status" }, h("p", {}, title), progress, doing, h("button", { type: "button", class: "quiet", onclick: () => stop.abort() }, "Cancel")));
  const onProgress = (job) => {
    const share = Math.round(100 * job.progress);
    bar.style.width = `${share}%`;
    progress.setAttribute("aria-valuenow", share);
    doing.textContent = job.doing;
  };
  const again = (text) => show(place, h("div", { class: "refused" }, h("p", {}, text), h("button", { type: "button", onclick: () => runIn(place, title, address, body, draw, leaving, { fresh }) }, "Try again")));
  try {
    const result = await run(address, body, { onProgress, signal: stop.signal, fresh });
    if (stop.signal.aborted || !place.isConnected) return;
    await draw(result);
  } catch (problem) {
    if (place.isConnected) again(problem.name === "AbortError" ? "Cancelled." : problem.message);
  }
}
