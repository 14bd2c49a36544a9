// Switching faults of the demo's machines.

import { call, path } from "../lib/api.js";
import { h, notify, panel, refresh } from "../lib/dom.js";
import { number, title } from "../lib/format.js";

// The order goes over the machine's own bus; the machine reports back a moment later [ms].
const REPORTS_BACK = [400, 800, 1600];

export async function faultPanel(machine) {
  const address = path("demo", "machines", machine, "fault");
  let state;
  try {
    state = await call(address);
  } catch (problem) {
    if (problem.status !== 404) notify(problem.message);
    return null;
  }
  const place = h("div", { class: "faults" });
  const typed = new Map(); // sizes typed and not sent yet: they outlive the next drawing
  let orders = 0;
  const draw = () => refresh(place, () => state.faults.map((fault) => row(fault, typed, set)));
  const set = async (fault, size) => {
    const mine = ++orders; // what an earlier order reports back is no longer asked for
    const take = (answer) => {
      if (mine !== orders || !place.isConnected) return false;
      state = answer;
      draw();
      return true;
    };
    try {
      const answer = await call(address, { method: "POST", body: { fault, size } });
      typed.delete(fault);
      for (let read = take(answer), index = 0; read && index < REPORTS_BACK.length; index += 1) {
        await new Promise((resume) => setTimeout(resume, REPORTS_BACK[index]));
        read = mine === orders && take(await call(address));
      }
    } catch (problem) {
      notify(problem.message);
    }
  };
  draw();
  return panel("Faults of this simulated machine", null, place);
}

function row({ id, on, size, unit = "", default_size: defaultSize, meaning }, typed, set) {
  const input = h("input", {
    type: "number",
    min: 0,
    step: "any",
    value: on ? size : (typed.get(id) ?? defaultSize ?? ""),
    "data-key": `size-${id}`,
    disabled: on,
    oninput: () => typed.set(id, input.value),
  });
  const button = h(
    "button",
    {
      type: "button",
      class: on ? "" : "quiet",
      "aria-pressed": String(on),
      "data-key": `fault-${id}`,
      onclick: () => set(id, on ? 0 : input.value === "" ? null : Number(input.value)),
    },
    on ? "Switch off" : "Switch on",
  );
  return h(
    "div",
    { class: "fault" },
    h("span", { class: "name" }, title(id), on ? h("strong", { class: "above" }, ` is on, ${number(size)} ${unit}`) : null),
    h("label", {}, "size", input, unit),
    button,
    meaning ? h("span", { class: "meaning muted small" }, meaning) : null,
  );
}
