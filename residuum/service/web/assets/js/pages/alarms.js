// The list of alarms, with what an operator does with them.

import { call, path } from "../lib/api.js";
import { h, notify } from "../lib/dom.js";
import { ago, count, moment } from "../lib/format.js";
import { badge, said } from "../lib/parts.js";

const asked = new Set(); // alarms whose operation is under way: pressing twice sends once

async function operate(alarm, verb, body) {
  if (asked.has(alarm.id)) return;
  asked.add(alarm.id);
  const sent = drafts.get(alarm.id);
  try {
    await call(path("alarms", alarm.id, verb), { method: "POST", body });
    if (drafts.get(alarm.id) === sent) drafts.delete(alarm.id); // a comment begun since then is not this operation's
  } catch (problem) {
    notify(problem.message);
  } finally {
    asked.delete(alarm.id);
  }
}

// What nobody has seen first, then by priority, a machine's fault before a signal's, then the newest.
const PRIORITIES = ["high", "medium", "low"];
const urgent = ({ priority }) => (PRIORITIES.indexOf(priority) + PRIORITIES.length + 1) % (PRIORITIES.length + 1);
const UNSEEN_FIRST = ["unacknowledged", "returned-unacknowledged", "acknowledged"];
const rank = ({ state }) => (UNSEEN_FIRST.indexOf(state) + UNSEEN_FIRST.length + 1) % (UNSEEN_FIRST.length + 1);
const byUrgency = (a, b) => rank(a) - rank(b) || urgent(a) - urgent(b) || a.kind.localeCompare(b.kind) || b.id - a.id;

export function alarmList(alarms, { withAsset = true } = {}) {
  if (!alarms.length) return h("p", { class: "empty" }, "No alarms.");
  return h(
    "ul",
    { class: "alarm-list" },
    alarms.sort(byUrgency).map((alarm) => item(alarm, withAsset)),
  );
}

function item(alarm, withAsset) {
  const times = alarm.occurrences > 1 ? `, ${count(alarm.occurrences)} times` : "";
  return h(
    "li",
    { class: "alarm" },
    h(
      "div",
      { class: "what" },
      badge(alarm.state),
      alarm.priority ? h("b", {}, `${alarm.priority} priority`) : null,
      withAsset
        ? h("a", { href: `#/machines/${encodeURIComponent(alarm.asset)}`, "data-key": `alarm-asset-${alarm.id}` }, alarm.asset)
        : null,
      h(
        "span",
        { class: "muted small", title: moment(alarm.raised_at) },
        `${alarm.condition ? "since" : "was raised"} ${ago(alarm.raised_at)}${times}`,
      ),
    ),
    h(
      "div",
      { class: "message" },
      h("div", { class: "clamp", title: alarm.message }, alarm.kind === "signal" ? "Signal: " : "", said(alarm.message ?? "")),
      remarks(alarm),
      alarm.window
        ? h(
            "a",
            {
              class: "small",
              href: `#/machines/${encodeURIComponent(alarm.asset)}?window=${alarm.window}`,
              "data-key": `alarm-window-${alarm.id}`,
            },
            `See window ${alarm.window}`,
          )
        : null,
    ),
    h("div", { class: "actions" }, actions(alarm)),
  );
}

function remarks(alarm) {
  const says = alarm.comment ? `: ${alarm.comment}` : "";
  const acknowledged = alarm.acknowledged_by ? `acknowledged by ${alarm.acknowledged_by}${says}` : null;
  const lines = [
    alarm.suppressed_by ? `suppressed while ${alarm.suppressed_by}` : null,
    alarm.state === "shelved" ? `shelved until ${moment(alarm.shelved_until)}${acknowledged ? "" : says}` : null,
    acknowledged,
  ];
  return lines.filter(Boolean).map((line) => h("div", { class: "muted small" }, line));
}

function actions(alarm) {
  const button = (verb, text, body) =>
    h(
      "button",
      {
        class: "quiet",
        type: "button",
        "data-key": `${verb}-${alarm.id}`,
        "aria-label": `${text} the alarm of ${alarm.asset}`,
        onclick: () => operate(alarm, verb, body()),
      },
      text,
    );
  const back = COMING_BACK[alarm.state];
  if (back) return alarm.suppressed_by ? null : button(...back, () => undefined); // what a state suppresses comes back with it
  const remark = () => (drafts.get(alarm.id) ? { comment: drafts.get(alarm.id) } : {}); // what was typed goes with either button
  const shelve = button("shelve", "Shelve 1 h", () => ({ minutes: 60, ...remark() }));
  if (alarm.state !== "acknowledged") return [button("acknowledge", "Acknowledge", remark), commentForm(alarm), shelve];
  const gone = alarm.condition ? null : button("reset", "Reset", remark); // a latched one waits for it
  return [gone, commentForm(alarm), shelve];
}

const COMING_BACK = {
  shelved: ["unshelve", "Unshelve"],
  suppressed: ["release", "Release"],
  "out-of-service": ["return-to-service", "Return to service"],
};
const WHILES = { 15: "15 min", 60: "1 h", 480: "8 h", 1440: "1 d", 10080: "7 d" }; // minutes

// All that can be done with a comment; what is being typed outlives the list's next drawing, as does the form's being open.
const drafts = new Map();
function commentForm(alarm) {
  const input = h("input", {
    "data-key": `comment-${alarm.id}`,
    "aria-label": `Comment on the alarm of ${alarm.asset}`,
    maxlength: 1000,
    value: drafts.get(alarm.id) ?? "",
    oninput: () => drafts.set(alarm.id, input.value),
  });
  const send = (event) => {
    event.preventDefault();
    const verb = event.submitter?.value || (alarm.state === "acknowledged" ? "shelve" : "acknowledge");
    const comment = input.value ? { comment: input.value } : {};
    operate(alarm, verb, verb === "shelve" ? { minutes: Number(minutes.value), ...comment } : comment);
  };
  const minutes = h(
    "select",
    { "data-key": `minutes-${alarm.id}`, "aria-label": `How long the alarm of ${alarm.asset} is shelved` },
    Object.entries(WHILES).map(([value, text]) => h("option", { value, selected: value === "60" }, text)),
  );
  const button = (verb, text) => h("button", { value: verb, class: "quiet", "data-key": `with-${verb}-${alarm.id}` }, text);
  let opening = false; // by a press, not by being drawn open
  const press = () => {
    opening = !details.open;
    if (opening) drafts.set(alarm.id, input.value);
    else drafts.delete(alarm.id);
  };
  const details = h(
    "details",
    {
      class: "comment",
      open: drafts.has(alarm.id),
      ontoggle: () => {
        if (opening && details.open) input.focus();
      },
    },
    h("summary", { "data-key": `comments-${alarm.id}`, onclick: press }, "Comment …"),
    h(
      "form",
      { onsubmit: send },
      input,
      alarm.state === "acknowledged"
        ? null
        : h("button", { value: "acknowledge", "data-key": `send-${alarm.id}` }, "Acknowledge with comment"),
      h("span", { class: "controls" }, button("shelve", "Shelve for"), minutes),
      button("suppress", "Suppress"),
      button("remove-from-service", "Take out of service"),
    ),
  );
  return details;
}
