// What was found at the machine of what a finding said: shown beside the finding, and told in a small form.

import { call, path } from "../lib/api.js";
import { h, notify, once, show } from "../lib/dom.js";
import { effectTitle } from "../lib/effect_titles.js";
import { moment, percent } from "../lib/format.js";

const OUTCOMES = { confirmed: "It was so", corrected: "It was something else", refuted: "There was no such thing" };

// Draws what is known of a finding into a place; what is told there is known at once. What is drawn already stays: somebody may
// be writing.
export function drawFound(place, asset, finding) {
  const says = finding && finding.verdict !== "not-assessable" ? `${finding.id} ${finding.confirmation?.id ?? ""}` : "";
  if (place.dataset.says === says) return;
  place.dataset.says = says;
  const told = (confirmation) => drawFound(place, asset, { ...finding, confirmation });
  if (says) show(place, known(finding.confirmation), form(asset, finding, told));
  else show(place);
}

function known(found) {
  if (!found) return null;
  const words = [
    OUTCOMES[found.outcome] ?? found.outcome,
    found.cause ? `: ${found.cause}` : "",
    found.part ? `, ${found.part}` : "",
    found.order ? `, order ${found.order}` : "",
    ` (${found.who}, ${moment(found.found_at)})`,
    found.note ? `. ${found.note}` : "",
  ];
  const learned = found.healthy ? " Its window is learned from as a healthy one." : "";
  return h("p", { class: "found" }, h("b", {}, "Found at the machine: "), `${words.join("")}.${learned}`);
}

const text = (name, label, most, more = {}) =>
  h("label", {}, label, h("input", { name, maxlength: most, "data-key": name, ...more }));

function form(asset, finding, told) {
  const causes = (finding.evidence?.causes ?? []).slice(1);
  const names = causes.map(({ name, place }) => (place ? `${name} of ${place}` : name));
  const cause = text("cause", "what it was", 200, { list: "causes-said" });
  const healthy = h(
    "label",
    {},
    h("input", { type: "checkbox", name: "healthy", "data-key": "healthy" }),
    "learn from this window as a healthy one",
  );
  const fits = () => {
    cause.hidden = outcome.value !== "corrected";
    healthy.hidden = outcome.value !== "refuted" || finding.verdict !== "faulty";
  };
  const outcome = h(
    "select",
    { name: "outcome", "data-key": "outcome", onchange: fits },
    Object.entries(OUTCOMES).map(([value, label]) => h("option", { value }, label)),
  );
  const send = once(async (event) => {
    const given = new FormData(event.target);
    const body = Object.fromEntries([...given].filter(([, value]) => value !== ""));
    if (cause.hidden) delete body.cause;
    if (healthy.hidden) delete body.healthy;
    else if (body.healthy) body.healthy = true;
    try {
      told(await call(path("assets", asset, "findings", finding.id, "confirmations"), { method: "POST", body }));
    } catch (problem) {
      notify(problem.message);
    }
  });
  fits();
  const said = finding.verdict === "faulty" ? likeliest(finding) : "healthy";
  return h(
    "details",
    { class: "comment" },
    h("summary", { "data-key": "tell-found" }, "Tell what was found at the machine"),
    h(
      "form",
      { class: "controls", onsubmit: send },
      h("label", {}, `said: ${said}`, outcome),
      cause,
      h(
        "datalist",
        { id: "causes-said" },
        names.map((name) => h("option", { value: name })),
      ),
      text("part", "part", 200),
      text("order", "order", 100),
      text("who", "who looked", 200),
      text("note", "note", 2000),
      healthy,
      h("button", { "data-key": "send-found" }, "Keep"),
    ),
  );
}

function likeliest(finding) {
  const [first] = finding.evidence?.causes ?? [];
  if (!first) return effectTitle(finding.class ?? finding.verdict);
  const place = first.place ? ` of ${first.place}` : "";
  return `${effectTitle(first.name)}${place}${Number.isFinite(first.probability) ? `, ${percent(first.probability)}` : ""}`;
}
