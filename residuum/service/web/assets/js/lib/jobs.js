// Long work: send a request that becomes a job, show its progress, end it on demand; finished results are remembered.

import { call, path } from "./api.js";
import { h, show } from "./dom.js";

const works = new Map(); // request → its work, under way or done
const PAUSE = 300;

// Waits between two looks at a job; throws at once when the signal has been or becomes aborted.
const pause = (signal) =>
  new Promise((resolve, reject) => {
    signal?.throwIfAborted();
    const stop = () => {
      clearTimeout(timer);
      reject(signal.reason);
    };
    const timer = setTimeout(() => {
      signal?.removeEventListener("abort", stop);
      resolve();
    }, PAUSE);
    signal?.addEventListener("abort", stop, { once: true });
  });

// A request's job: whoever waits for it is told its progress. It is cancelled when the last of them has left.
class Work {
  constructor(address, body) {
    this.watchers = new Set();
    this.stop = new AbortController();
    this.result = this.follow(address, body);
  }

  // Resolves with the job's result, throws as soon as the signal is aborted.
  watch(onProgress, signal) {
    return new Promise((resolve, reject) => {
      this.watchers.add(onProgress);
      const leave = () => {
        this.watchers.delete(onProgress);
        if (!this.watchers.size) this.stop.abort();
        reject(signal.reason);
      };
      if (signal?.aborted) return leave();
      signal?.addEventListener("abort", leave, { once: true });
      if (this.job) onProgress(this.job);
      return this.result.then(resolve, reject).then(() => signal?.removeEventListener("abort", leave));
    });
  }

  async follow(address, body) {
    const { signal } = this.stop;
    this.job = await call(address, { method: "POST", body });
    const own = path("jobs", this.job.id);
    try {
      while (this.job.state === "queued" || this.job.state === "running") {
        for (const onProgress of this.watchers) onProgress(this.job);
        await pause(signal);
        this.job = await call(own);
        signal.throwIfAborted(); // asked to stop while the answer was on its way
      }
    } catch (problem) {
      if (problem.name === "AbortError") await call(own, { method: "DELETE" });
      throw problem;
    }
    if (this.job.state !== "done") throw new Error(this.job.error ?? `The work was ${this.job.state}.`);
    return this.job.result;
  }
}

// Resolves with the job's result; `onProgress` is told each state. What was asked before is not asked again, unless `fresh`.
export function run(address, body, { onProgress = () => {}, signal, fresh = false } = {}) {
  const key = `${address} ${JSON.stringify(body)}`;
  if (fresh || !works.has(key)) {
    const work = new Work(address, body);
    const forget = () => {
      if (works.get(key) === work) works.delete(key);
    };
    works.set(key, work);
    work.stop.signal.addEventListener("abort", forget);
    work.result.catch(forget);
  }
  return works.get(key).watch((job) => onProgress(job), signal);
}

const shown = new WeakMap(); // place → what ends the work that it shows

// Shows the job's progress in `place` with a button that cancels it, then what `draw(result, signal)` makes of the result.
// A place shows one work: a new one ends the one before.
export async function runIn(place, title, address, body, draw, leaving, { fresh = false } = {}) {
  shown.get(place)?.abort();
  const stop = new AbortController();
  shown.set(place, stop);
  const mine = () => shown.get(place) === stop && place.isConnected;
  leaving.push(() => stop.abort());
  const bar = h("i", { style: { width: "0%" } });
  const doing = h("p", { class: "muted small" }, "waiting");
  const progress = h(
    "div",
    { class: "progress", role: "progressbar", "aria-label": title, "aria-valuemin": 0, "aria-valuemax": 100, "aria-valuenow": 0 },
    bar,
  );
  const cancel = h("button", { type: "button", class: "quiet", onclick: () => stop.abort() }, "Cancel");
  const inside = place.contains(document.activeElement); // who began the work by keyboard can end it
  show(place, h("div", { class: "working", role: "status" }, h("p", {}, title), progress, doing, cancel));
  if (inside) cancel.focus({ preventScroll: true });
  const onProgress = (job) => {
    const share = Math.round(100 * job.progress);
    bar.style.width = `${share}%`;
    progress.setAttribute("aria-valuenow", share);
    doing.textContent = job.doing;
  };
  const again = (text) =>
    show(
      place,
      h(
        "div",
        { class: "refused" },
        h("p", {}, text),
        h("button", { type: "button", onclick: () => runIn(place, title, address, body, draw, leaving, { fresh }) }, "Try again"),
      ),
    );
  try {
    const result = await run(address, body, { onProgress, signal: stop.signal, fresh });
    if (mine()) await draw(result, stop.signal);
  } catch (problem) {
    if (mine()) again(problem.name === "AbortError" ? "Cancelled." : problem.message);
  }
}
