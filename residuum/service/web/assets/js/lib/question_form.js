// The form of a question, drawn from what the service's interface declares of its fields: name, help, default, bounds, names
// to choose from, and where a field counts. What is declared in Python is on the page with that.

import { described } from "./api.js";
import { h, show } from "./dom.js";
import { title } from "./format.js";

const LONG_TEXT = 1000; // characters that a text may have, from which on it is written in several lines
let forms = 0;

/** The fields of what is asked at an address: name → its schema, with `required`. */
export async function fieldsOf(address) {
  const { paths, components } = await described();
  const { post, get } = paths[`/api/v1${address}`];
  if (!post) return Object.fromEntries(get.parameters.map(({ schema, ...told }) => [told.name, { ...schema, ...told }]));
  return schemaFields(components, post.requestBody.content["application/json"].schema.$ref.split("/").at(-1));
}

export function schemaFields({ schemas }, name) {
  const { properties, required = [] } = schemas[name];
  const entries = Object.entries(properties).map(([each, schema]) => [each, { ...schema, required: required.includes(each) }]);
  return Object.fromEntries(entries);
}

/** The same without those that the page says itself; `known` is what it knows of some: `default`, `enum`, `titles`, `label`. */
export function adapted(fields, without, known = {}) {
  const kept = Object.entries(fields).filter(([name, field]) => !without.includes(name) && !field.deprecated);
  return Object.fromEntries(kept.map(([name, field]) => [name, { ...field, ...known[name] }]));
}

const parts = (field) => (field.anyOf ?? [field]).filter((part) => part.type !== "null");
const kindOf = (field) => parts(field).at(-1);
const severalOf = (field) => kindOf(field).type === "array" && Boolean(field.enum);
const separator = (field) => (field.enum ? "\n" : ",");

// A value as it is written in a form and in an address, and back.
function written(field, value) {
  if (value === null || value === undefined) return "";
  if (Array.isArray(value)) return value.map((each) => each ?? "").join(separator(field));
  if (typeof value !== "object") return String(value);
  return Object.entries(value)
    .map(([name, each]) => `${name}=${[each].flat().join(":")}`)
    .join(", ");
}

const figure = (text) => (text.trim() === "" ? null : Number(text));

function read(field, text) {
  const kind = kindOf(field);
  if (kind.type === "boolean") return text === "true";
  if (kind.type === "integer" || kind.type === "number") return Number(text);
  if (kind.prefixItems) return text.split(",").map(figure);
  if (kind.type === "array")
    return text
      .split(separator(field))
      .map((each) => each.trim())
      .filter(Boolean);
  if (kind.type === "object") return Object.fromEntries(text.split(",").filter(Boolean).map(assigned));
  const mayBeNumber = parts(field).some((part) => part.type === "number");
  return mayBeNumber && Number.isFinite(figure(text) ?? Number.NaN) ? Number(text) : text;
}

// `k_d=0` and `k_i=0:0.3`, as on the command line.
function assigned(text) {
  const [name, values = ""] = text.split("=");
  const found = values.split(":").map(figure);
  return [name.trim(), found.length > 1 ? found : found[0]];
}

const holds = (ways, value) =>
  !ways || ways.some((way) => Object.entries(way).every(([other, values]) => values.includes(value(other))));

// What is said of every field: the texts that were typed, else the defaults; a name that is not offered is not said.
class Said {
  constructor(fields, asked) {
    this.fields = fields;
    this.asked = asked;
    this.valueOf = (name) => {
      const text = name in fields ? this.text(name) : "";
      return text === "" ? null : read(fields[name], text);
    };
  }

  counts(name) {
    return holds(this.fields[name]["x-only-with"], this.valueOf);
  }

  offered(name) {
    const field = this.fields[name];
    const names = field.enum ?? kindOf(field).enum;
    return names?.map(String).filter((each) => holds(field["x-choices-only-with"]?.[each], this.valueOf));
  }

  text(name) {
    const [field, text, names] = [this.fields[name], this.asked[name], this.offered(name)];
    const known = (said) => !names || said.split(severalOf(field) ? "\n" : undefined).every((each) => names.includes(each));
    if (text !== undefined && (text === "" || known(text))) return text;
    const standard = written(field, field.default);
    return field.required && names && !severalOf(field) && !known(standard) ? (names[0] ?? "") : standard;
  }

  body() {
    const said = Object.keys(this.fields).filter((name) => this.counts(name) && this.valueOf(name) !== null);
    return Object.fromEntries(said.map((name) => [name, this.valueOf(name)]));
  }
}

/**
 * The form of `fields`. `asked` holds what differs from the defaults, as text by name, and is changed as it is typed.
 * `first` are names of fields, and elements of the page's own, that are shown at once; the others are folded. `scope` goes
 * before the names of controls where a page has several forms. Gives `{form, body}`; `body(others)` is the request, with some
 * texts other than asked.
 */
export function questionForm(fields, asked, { first, submit, onsubmit, more = "More options", scope = "", changed = () => {} }) {
  const number = ++forms;
  const said = new Said(fields, asked);
  const tell = (name) => (text) => {
    if (text === "" || text === written(fields[name], fields[name].default)) delete asked[name];
    else asked[name] = text;
    refresh();
    changed(name);
  };
  const drawn = new Map(
    Object.keys(fields).map((name) => [
      name,
      drawField(name, said, tell(name), `help-${number}-${name}`, first.includes(name), scope + name),
    ]),
  );
  function refresh() {
    for (const [name, { place, offer }] of drawn) {
      place.hidden = !said.counts(name);
      for (const control of place.querySelectorAll("input, select, textarea")) control.disabled = place.hidden;
      offer?.();
    }
    if (fold) fold.hidden = folded.every((name) => drawn.get(name).place.hidden);
  }
  const folded = Object.keys(fields).filter((name) => !first.includes(name));
  const fold = folded.length
    ? h(
        "details",
        { class: "more", open: folded.some((name) => name in asked) },
        h("summary", { "data-key": `${scope}more` }, more),
        h(
          "div",
          { class: "fields" },
          folded.map((name) => drawn.get(name).place),
          first.length ? null : submit,
        ),
      )
    : null;
  fold?.addEventListener("invalid", () => fold.setAttribute("open", ""), true); // what is folded could not be corrected
  refresh();
  const form = h(
    "form",
    {
      class: "stack",
      onsubmit: (event) => {
        event.preventDefault();
        onsubmit();
      },
    },
    first.length
      ? h("div", { class: "fields" }, [
          ...first.map((each) => (typeof each === "string" ? drawn.get(each)?.place : each)),
          submit,
        ])
      : null,
    fold,
  );
  return { form, body: (others = {}) => new Said(fields, { ...asked, ...others }).body() };
}

// `settling time [s]`: the unit is in the help.
const labelOf = (name, { label, description = "" }) =>
  label ?? `${title(name)} ${description.match(/\[[^\]]+\]/)?.[0] ?? ""}`.trim();

// A field's element, and what offers its choices anew. Its help is in sight where it is folded, else it comes with the pointer.
function drawField(name, said, tell, id, inSight, key) {
  const field = said.fields[name];
  const kind = kindOf(field);
  const shared = inSight
    ? { "data-key": key, title: field.description }
    : { "data-key": key, "aria-describedby": field.description ? id : null };
  const help = inSight || !field.description ? null : h("p", { class: "muted small", id }, field.description);
  const text = said.text(name);
  const label = labelOf(name, field);
  const wrap = (...content) => h("div", { class: "field" }, content, help);
  const group = (...content) =>
    wrap(h("fieldset", { title: shared.title, "aria-describedby": shared["aria-describedby"] }, h("legend", {}, label), content));
  if (kind.type === "boolean") {
    const tick = h("input", {
      ...shared,
      type: "checkbox",
      checked: text === "true",
      onchange: () => tell(String(tick.checked)),
    });
    return { place: wrap(h("label", { class: "tick" }, tick, label)) };
  }
  if (severalOf(field)) {
    const chosen = new Set(text.split("\n").filter(Boolean));
    const tick = (each) => (event) => {
      chosen[event.target.checked ? "add" : "delete"](each);
      tell(
        said
          .offered(name)
          .filter((one) => chosen.has(one))
          .join("\n"),
      );
    };
    const box = (each) =>
      h(
        "label",
        { class: "choice" },
        h("input", { type: "checkbox", "data-key": `${key}-${each}`, checked: chosen.has(each), onchange: tick(each) }),
        h("span", { class: "name", title: each }, shown(field, each)),
      );
    return { place: group(h("div", { class: "choices" }, said.offered(name).map(box))) };
  }
  if (kind.prefixItems) {
    const ends = kind.prefixItems.map((_, index) =>
      h("input", {
        type: "number",
        step: "any",
        "data-key": `${key}-${index}`,
        "aria-label": `${label}, ${index ? "upper" : "lower"}`,
        placeholder: "none",
        value: text.split(",")[index]?.trim() ?? "",
        oninput: () => tell(ends.some((end) => end.value) ? ends.map((end) => end.value).join(",") : ""),
      }),
    );
    return { place: group(h("div", { class: "pair" }, ends)) };
  }
  if (said.offered(name)) {
    const select = h("select", { ...shared, required: field.required, onchange: () => tell(select.value) });
    const none = field.required || (field.default ?? null) !== null ? [] : [""];
    const offer = () =>
      show(
        select,
        [...none, ...said.offered(name)].map((each) =>
          h("option", { value: each, selected: each === said.text(name) }, shown(field, each)),
        ),
      );
    return { place: wrap(h("label", {}, label, select)), offer };
  }
  return { place: wrap(h("label", {}, label, typed(field, kind, { ...shared, value: text }, tell))) };
}

const shown = (field, each) => (each === "" ? "–" : ((field.titles ?? field["x-titles"])?.[each] ?? title(each)));

// What is typed: a number within its bounds, a text, or a text of several lines.
function typed(field, kind, shared, tell) {
  const { minimum, maximum, exclusiveMinimum: above, exclusiveMaximum: below } = kind;
  const isNumber = kind.type === "number" || kind.type === "integer";
  const example = field.examples ? `e.g. ${written(field, field.examples[0])}` : null;
  const input = h(kind.maxLength > LONG_TEXT ? "textarea" : "input", {
    ...shared,
    ...(isNumber
      ? { type: "number", step: kind.type === "integer" ? 1 : "any", min: minimum ?? above, max: maximum ?? below }
      : {}),
    pattern: kind.pattern?.replaceAll(/\[([^\]]*[^\\])-\]/g, "[$1\\-]"),
    placeholder: example,
    required: field.required,
    oninput: () => {
      const limit = [above, below].find((each) => each !== undefined && input.value !== "" && Number(input.value) === each);
      const sign = limit === above ? ">" : "<";
      input.setCustomValidity(limit === undefined ? "" : `must be ${sign} ${limit}`);
      tell(input.value);
    },
  });
  return input;
}
