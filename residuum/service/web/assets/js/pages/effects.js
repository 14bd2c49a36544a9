// The catalogue of physical effects, to read and to search: equation, signature, parameters with units, where it was found.

import { signaturePicture } from "../charts/signature.js";
import { call } from "../lib/api.js";
import { h, notify, show } from "../lib/dom.js";
import { number, quantity, unitText } from "../lib/format.js";

const FEW = 4; // so many are shown in full on a phone, where all of them would be twenty screens
const wide = matchMedia("(min-width: 621px)");

export function effectsPage(place) {
  document.title = "Effects · Residuum";
  const list = h("div", { class: "catalogue" });
  const search = h("input", { type: "search", id: "search", placeholder: "friction, heat, …", oninput: () => draw() });
  const tally = h("span", { class: "muted", role: "status" });
  show(
    place,
    h(
      "div",
      { class: "title" },
      h("h1", {}, "Effects"),
      h("label", { class: "controls", for: "search" }, "search", search),
      tally,
    ),
    h(
      "p",
      { class: "muted" },
      "What the workbench can find missing in a model: one more term in a balance, or one more stage on the path of an " +
        "input or output. Each picture is the effect's own equation along a standard movement; dashed: the signal without it.",
    ),
    list,
  );
  let effects = [];
  const signatures = new Map();
  const uses = new Map();

  function draw() {
    const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
    const shown = effects.filter((effect) => words.every((word) => JSON.stringify(effect).toLowerCase().includes(word)));
    tally.textContent = `${shown.length} of ${effects.length}`;
    const unfolded = new Set([...list.querySelectorAll("[open]")].map((each) => each.dataset.key));
    const open = ({ effect }) => wide.matches || shown.length <= FEW || unfolded.has(effect);
    show(
      list,
      shown.length
        ? shown.map((effect) => card(effect, signatures.get(effect.effect), uses.get(effect.effect) ?? [], open(effect)))
        : h("p", { class: "empty" }, "No effect has these words."),
    );
  }

  const read = async () => {
    effects = (await call("/effects")).items;
    draw();
    const [drawn, found] = await Promise.all([call("/effects/signatures"), call("/effects/uses")]);
    for (const each of drawn.items) signatures.set(each.effect, each);
    for (const each of found.items) uses.set(each.effect, [...(uses.get(each.effect) ?? []), each]);
    if (list.isConnected) draw();
  };
  read().catch((problem) => notify(problem.message));
  return () => {};
}

function card(effect, drawn, uses, open) {
  return h(
    "details",
    { class: "panel effect", "data-key": effect.effect, open },
    h("summary", {}, h("h2", {}, effect.title)),
    h(
      "p",
      { class: "equation" },
      effect.equation.split(/_([A-Za-z0-9]+)/).map((part, index) => (index % 2 ? h("sub", {}, part) : part)),
    ),
    drawn ? signaturePicture(effect.title, drawn) : h("div", { class: "signature" }),
    drawn
      ? h(
          "ul",
          { class: "plain small" },
          drawn.parameters.map((each) =>
            h(
              "li",
              {},
              h("b", {}, each.name),
              unitText(each.unit) ? ` [${unitText(each.unit)}]` : "",
              `: ${each.meaning}`,
              h(
                "span",
                { class: "muted" },
                ` (drawn with ${unitText(each.unit) ? quantity(each.value, each.unit) : number(each.value)})`,
              ),
            ),
          ),
        )
      : null,
    h(
      "dl",
      { class: "facts" },
      fact("Acts on", effect.acts_on.join(", ")),
      effect.needs.length ? fact("Needs", effect.needs.join(", ")) : null,
      fact("Id", effect.effect),
      uses.length
        ? fact(
            "Found in",
            uses.map((use, index) => [
              index ? ", " : "",
              h("a", { href: workbenchOf(use) }, `${use.model.slice(0, 64)}${use.version ? `, version ${use.version}` : ""}`),
              ` (${use.balance.slice(0, 40)})`,
            ]),
          )
        : null,
    ),
    h("p", { class: "muted small" }, effect.reference),
  );
}

const fact = (name, value) => h("div", {}, h("dt", {}, name), h("dd", {}, value));

function workbenchOf({ model, version }) {
  return `#/workbench?${new URLSearchParams({ model, ...(version ? { version } : {}) })}`;
}
