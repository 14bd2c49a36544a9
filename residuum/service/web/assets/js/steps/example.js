// Something to try where a page begins empty: a hint, and a button that has the service simulate a machine's record.

import { h, once } from "../lib/dom.js";
import { runIn } from "../lib/jobs.js";

export const DRIVE = { machine: "gate-drive", effects: { "coulomb-friction": { tau_c: 0.06 } }, duration: 15, seed: 3 };
export const PROCESS = { machine: "process", seed: 1 };

export const offer = (hint, label, onclick) =>
  h(
    "div",
    { class: "offer", role: "note" },
    h("p", {}, hint),
    h("button", { type: "button", "data-key": "example", onclick: once(onclick) }, label),
  );

// Shows the simulation's progress in `place`; `then(record)` goes on with the record, stored beside uploaded ones.
export const simulateIn = (place, machine, then, leaving) =>
  runIn(place, "Simulating a record", "/records/simulations", machine, then, leaving, { fresh: true });
