// Which of a diagnoser's two methods decides: chosen on a machine's page, and when its baseline is trained.

import { call, path } from "../lib/api.js";
import { h, notify, show } from "../lib/dom.js";
import { plant } from "../lib/plant_state.js";

const TITLES = { default: "the default method", source: "the source's method" };

const methodsOf = (diagnoser) => plant.diagnosers.get(diagnoser)?.methods ?? [];

// A select of the methods of a diagnoser with two; null for any other.
export function methodSelect(diagnoser) {
  const methods = methodsOf(diagnoser);
  if (methods.length < 2) return null;
  const option = (name) => h("option", { value: name }, TITLES[name] ?? name);
  return h("select", { "data-key": "method" }, methods.map(option));
}

// The choice on a machine's page; it takes effect with the next window.
export async function methodChoice(place, asset) {
  const address = path("assets", asset, "method");
  if (methodsOf(plant.assets.get(asset)?.diagnoser).length < 2) return;
  const told = h("span", { class: "muted small", role: "status" });
  const put = async () => {
    try {
      const { chosen } = await call(address, { method: "PUT", body: { method: select.value || null } });
      told.textContent = chosen ? `${TITLES[chosen]} decides from the next window on` : "as trained, from the next window on";
    } catch (problem) {
      notify(problem.message);
    }
  };
  const select = h("select", { "data-key": "deciding-method", onchange: put });
  try {
    const { methods, chosen } = await call(address);
    const option = (name) => h("option", { value: name, selected: name === (chosen ?? "") }, TITLES[name] ?? "as it was trained");
    show(select, ["", ...methods].map(option));
    show(place, h("p", { class: "controls" }, h("label", {}, "what decides", select), told));
  } catch (problem) {
    notify(problem.message);
  }
}
