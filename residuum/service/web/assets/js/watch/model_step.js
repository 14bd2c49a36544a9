// Step 4: the machine's model, built in, stored or written here, and which signal of the bus is which of the model.

import { call } from "../lib/api.js";
import { h, notify, once, panel, show } from "../lib/dom.js";
import { unitText } from "../lib/format.js";
import { modelName } from "../lib/model_name.js";
import { tableHead } from "../lib/table_head.js";

const TEMPLATE = `name: my-machine
inputs:      {voltage: V}
states:      {theta: {unit: rad, rate: omega}, omega: {unit: rad/s}}
parameters:
  K: {value: 0.05, unit: V*s/rad, lower: 0}
  R: {value: 1.0, unit: ohm, lower: 0}
  J: {value: 5e-4, unit: kg*m**2, lower: 0}
balances:
  shaft:     {kind: torque, storage: J * der(omega), terms: {motor: K * i}, position: theta, velocity: omega}
  winding:   {kind: voltage, storage: 0, terms: {supply: voltage, resistance: -R * i, back_emf: -K * omega}, current: i}
outputs:     {speed: {value: omega, unit: rad/s}, current: {value: i, unit: A}}
`;

export async function modelStep(place, way) {
  const [builtIn, stored] = await Promise.all([call("/models/built-in/descriptions"), call("/models?kind=physical&limit=200")]);
  const own = stored.items.filter((each) => !each.model.endsWith(".model")).map((each) => each.model);
  const names = [...own, ...builtIn.items.map((each) => each.model)];
  const mapping = h("div");
  const select = h("select", { "data-key": "model", onchange: () => choose(select.value) });
  const draw = (chosen) =>
    show(
      select,
      h("option", { value: "" }, "choose a model …"),
      names.map((each) => h("option", { value: each, selected: each === chosen }, each)),
    );
  const choose = (name) => (name ? drawMapping(mapping, way, name).catch((problem) => notify(problem.message)) : show(mapping));
  const made = (name) => {
    if (!names.includes(name)) names.unshift(name);
    draw(name);
    choose(name);
  };
  draw(way.settings.model);
  show(
    place,
    panel(
      "Which model describes it?",
      null,
      h(
        "div",
        { class: "stack" },
        h("p", { class: "muted" }, "It need not be exact: the next step finds what it lacks."),
        h("div", { class: "controls" }, h("label", {}, "model", select)),
        editor(way, made),
      ),
    ),
    mapping,
  );
  if (way.settings.model) choose(way.settings.model);
}

function editor(way, made) {
  const text = h("textarea", { rows: 12, spellcheck: "false", class: "code", "aria-label": "Model file", value: TEMPLATE });
  const file = h("input", {
    type: "file",
    accept: ".yaml,.yml",
    "aria-label": "Upload a model file",
    "data-key": "model-file",
    onchange: async () => {
      text.value = await file.files[0].text();
      name.value = modelName(file.files[0].name);
    },
  });
  const name = h("input", {
    value: `${way.machine}-model`.slice(0, 60),
    pattern: "[A-Za-z0-9][A-Za-z0-9._\\-]{0,63}",
    required: true,
    "aria-label": "Name of the model",
  });
  const store = once(async () => {
    try {
      made(
        (await call(`/models?name=${encodeURIComponent(name.value)}&kind=physical`, { method: "POST", file: text.value })).model,
      );
    } catch (problem) {
      notify(problem.message);
    }
  });
  return h(
    "details",
    { class: "editor" },
    h("summary", {}, "Upload or write a model file"),
    h(
      "form",
      { class: "editor-form", onsubmit: store },
      file,
      text,
      h("div", { class: "controls" }, h("label", {}, "store as", name), h("button", { "data-key": "store-model" }, "Store")),
    ),
  );
}

async function drawMapping(place, way, model) {
  const { signals, bus } = await call(`${way.address("channel-guess")}?model=${encodeURIComponent(model)}`);
  const chosen = Object.fromEntries(signals.map((signal) => [signal.name, signal.channel ?? ""]));
  const option =
    (signal) =>
    ([name, unit]) =>
      h("option", { value: name, selected: name === chosen[signal.name] }, `${name} [${unitText(unit) || "1"}]`);
  const row = (signal) =>
    h(
      "tr",
      {},
      h("td", { "data-label": "Model" }, h("span", {}, h("b", {}, signal.name), ` [${unitText(signal.unit) || "1"}]`)),
      h("td", { "data-label": "Role" }, signal.role),
      h(
        "td",
        { "data-label": "Bus" },
        h(
          "select",
          {
            "aria-label": `Signal for ${signal.name}`,
            "data-key": `map-${signal.name}`,
            onchange: (event) => {
              chosen[signal.name] = event.target.value;
            },
          },
          h("option", { value: "" }, signal.required ? "– choose –" : "not on the bus"),
          Object.entries(bus).map(option(signal)),
        ),
      ),
    );
  const use = once(async () => {
    const lacking = signals.find((signal) => signal.required && !chosen[signal.name]);
    if (lacking) return notify(`Choose the signal for ${lacking.name}: the model needs it.`);
    const bare = signals.find(({ name, unit }) => chosen[name] && unitText(unit) && !unitText(bus[chosen[name]]));
    if (bare) {
      const { name, unit } = bare;
      return notify(
        `${chosen[name]} has no unit, and ${name} is in ${unitText(unit)}: write the unit into the description under Source.`,
      );
    }
    try {
      await way.put({ model, channels: Object.fromEntries(Object.entries(chosen).filter(([, channel]) => channel)) });
      way.go("compare");
    } catch (problem) {
      notify(problem.message);
    }
    return undefined;
  });
  show(
    place,
    panel(
      "Which signal is which?",
      "guessed by name and unit",
      h(
        "table",
        { class: "reflow" },
        tableHead(["Signal of the model", "Role", "Signal of the bus"]),
        h("tbody", {}, signals.map(row)),
      ),
      h(
        "p",
        { class: "controls next" },
        h("button", { type: "button", "data-key": "use-model", onclick: use }, "Use this model"),
      ),
    ),
  );
}
