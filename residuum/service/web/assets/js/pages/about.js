// What this service offers to programs, and what is set in it.

import { call, described } from "../lib/api.js";
import { h, notify, panel, show } from "../lib/dom.js";
import { tableHead } from "../lib/table_head.js";

const table = (heads, rows) =>
  h(
    "div",
    { class: "scroll" },
    h(
      "table",
      { class: "reflow" },
      tableHead(heads),
      h(
        "tbody",
        {},
        rows.map((cells) =>
          h(
            "tr",
            {},
            cells.map((cell, index) => h("td", { "data-label": heads[index], class: index ? "wide" : null }, cell)),
          ),
        ),
      ),
    ),
  );

function begin(place, title, says, read) {
  document.title = `${title} · Residuum`;
  const body = h("div", { class: "stack" }, h("p", { class: "loading" }, "Loading …"));
  show(place, h("div", { class: "title" }, h("h1", {}, title), h("p", { class: "muted about" }, says)), body);
  read(body).catch((problem) => notify(problem.message));
  return () => {};
}

// The interface as it describes itself: a table a kind of thing, a row a call.
export function interfacePage(place) {
  const says = [
    "Everything that these pages do, programs can do, too. For tools: ",
    h("a", { href: "/openapi.json" }, "/openapi.json"),
    ".",
  ];
  return begin(place, "API", says, async (body) => {
    const { paths } = await described();
    const calls = Object.entries(paths).flatMap(([path, methods]) =>
      Object.entries(methods).map(([method, told]) => ({ path, method: method.toUpperCase(), ...told })),
    );
    const groups = Object.entries(Object.groupBy(calls, (each) => each.tags?.[0] ?? "other")).sort(([a], [b]) =>
      a.localeCompare(b),
    );
    const row = (each) => [
      h("b", {}, each.method),
      h("code", {}, each.path),
      (each.description ?? each.summary ?? "").split("\n")[0],
    ];
    show(
      body,
      h(
        "div",
        { class: "panel body stack" },
        groups.map(([tag, rows]) =>
          h(
            "details",
            {},
            h("summary", {}, `${tag} (${rows.length})`),
            table(["Method", "Address", "What it does"], rows.map(row)),
          ),
        ),
      ),
    );
  });
}

export function settingsPage(place) {
  const says = [
    "What is set in the running service. Each is set by an argument, RESIDUUM_… in the environment, or the settings file. ",
    h("a", { href: "/docs/" }, "How"),
  ];
  return begin(place, "Settings", says, async (body) => {
    const [{ items }, { receivers = {}, alarms = {} }] = await Promise.all([
      call("/settings"),
      // a service that can store nothing says so itself; what is set is shown all the same
      call("/health/ready").catch(() => ({})),
    ]);
    const troubles = [...Object.entries(receivers), ...Object.entries(alarms)];
    const row = ({ name, value, set, meaning }) => [
      h("code", {}, name),
      h("div", {}, h(set ? "b" : "span", {}, text(value)), set ? null : h("span", { class: "muted small" }, " (default)")),
      meaning,
    ];
    show(
      body,
      troubles.length
        ? panel("Alarms that do not arrive", "receivers, and machines with a rule", table(["Of", "Why"], troubles))
        : null,
      panel("Settings", "bold: set, not the default", table(["Setting", "Value", "What it means"], items.map(row))),
    );
  });
}

const text = (value) =>
  value === null || value === "" || (Array.isArray(value) && !value.length)
    ? "none"
    : Array.isArray(value)
      ? value.map(text).join(", ")
      : typeof value === "object"
        ? Object.entries(value)
            .map(([name, each]) => `${name} ${text(each)}`)
            .join(", ")
        : String(value);
