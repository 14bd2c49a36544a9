// The parameters of a model as a form: value, bounds, fixed. What is changed becomes a new version of the model.

import { call, path } from "../lib/api.js";
import { h, notify, once } from "../lib/dom.js";
import { unitText } from "../lib/format.js";
import { tableHead } from "../lib/table_head.js";

const HEADS = ["Parameter", "Value", "Lower", "Upper", "Unit", "Fixed"];

// `stored(version)` is told the version that was made; the model is `description.model`.
export function parameterForm(description, saveAs, stored) {
  const changes = {};
  const button = h("button", { disabled: true, "data-key": "store-parameters" }, "Store as a new version");
  const name = h("input", {
    value: saveAs,
    "aria-label": "Store under the name",
    pattern: "[A-Za-z0-9][A-Za-z0-9._\\-]{0,63}",
    required: true,
  });
  const change = (parameter, field, value) => {
    changes[parameter] = { ...changes[parameter], [field]: value };
    button.disabled = false;
  };
  const figure = (each, field, label) =>
    h(
      "td",
      { "data-label": label },
      h("input", {
        type: "number",
        step: "any",
        class: "figure",
        "aria-label": `${field} of ${each.name}`,
        "data-key": `${field}-${each.name}`,
        value: each[field] ?? "",
        required: field === "value",
        placeholder: field === "value" ? "" : "none",
        oninput: (event) => change(each.name, field, event.target.value === "" ? null : Number(event.target.value)),
      }),
    );
  const row = (each) =>
    h(
      "tr",
      {},
      h(
        "td",
        { "data-label": HEADS[0] },
        h("div", {}, each.name, each.meaning ? h("div", { class: "muted small" }, each.meaning) : null),
      ),
      figure(each, "value", HEADS[1]),
      figure(each, "lower", HEADS[2]),
      figure(each, "upper", HEADS[3]),
      h("td", { "data-label": HEADS[4] }, unitText(each.unit)),
      h(
        "td",
        { "data-label": HEADS[5] },
        h("input", {
          type: "checkbox",
          "aria-label": `${each.name} is fixed`,
          "data-key": `fixed-${each.name}`,
          checked: each.fixed,
          onchange: (event) => change(each.name, "fixed", event.target.checked),
        }),
      ),
    );
  const send = once(async () => {
    try {
      stored(
        await call(path("models", description.model, "parameters"), {
          method: "POST",
          body: { ...(description.version ? { version: description.version } : {}), parameters: changes, save_as: name.value },
        }),
      );
    } catch (problem) {
      notify(problem.message);
    }
  });
  return h(
    "form",
    { onsubmit: send },
    h(
      "div",
      { class: "scroll" },
      h("table", { class: "reflow parameters" }, tableHead(HEADS), h("tbody", {}, description.parameters.map(row))),
    ),
    h("p", { class: "controls next" }, h("label", {}, "as", name), button),
  );
}
