// Accept a model as a machine's active version: thresholds from its healthy windows are shown old against new first.

import { call, path } from "../lib/api.js";
import { h, notify, once, panel, show } from "../lib/dom.js";
import { assetTitle, moment, quantity, title } from "../lib/format.js";
import { runIn } from "../lib/jobs.js";
import { plant } from "../lib/plant_state.js";
import { tableHead } from "../lib/table_head.js";

const HEADS = ["What", "Old", "New"];

export function acceptancePanel(bench) {
  const machines = [...plant.assets.values()];
  if (!machines.length) return null;
  const place = h("div", { class: "stack" });
  const select = h(
    "select",
    { id: "machine", "data-key": "machine", onchange: () => bench.show({ machine: select.value }) },
    machines.map((asset) =>
      h("option", { value: asset.id, selected: asset.id === bench.shown.machine }, assetTitle(asset).slice(0, 60)),
    ),
  );
  const asked = { model: bench.model, ...(bench.version ? { version: bench.version } : {}) };
  const propose = () =>
    runIn(
      place,
      "Learning the thresholds from healthy windows",
      path("assets", select.value, "model-proposals"),
      { ...asked, map: bench.map },
      (found) => show(place, proposal(found)),
      bench.leaving,
      { fresh: true },
    );
  const accept = async (number, note) => {
    try {
      const { active } = await call(path("assets", select.value, "model"), {
        method: "POST",
        body: { ...asked, proposal: number, note },
      });
      show(
        place,
        h(
          "p",
          { role: "status" },
          `Accepted ${moment(active.created_at)} by ${active.created_by ?? "–"}: it is version ${active.number} of `,
          h("a", { href: `#/machines/${encodeURIComponent(select.value)}` }, "this machine's model"),
          ".",
        ),
      );
    } catch (problem) {
      notify(problem.message);
    }
  };

  function proposal(found) {
    const note = h("input", { "aria-label": "Note", placeholder: "why (kept with the version)", maxlength: 1000 });
    const { alarms } = found;
    return [
      h("div", { class: "scroll" }, thresholdTable(found)),
      h(
        "p",
        {},
        `On ${alarms.windows} healthy windows kept aside ` +
          `${alarms.old === null ? "" : `the present thresholds raise ${alarms.old} alarms, `}the new ones raise ${alarms.new}.`,
      ),
      found.model_error.reason
        ? h("p", { class: "muted small" }, `The model cannot be simulated on this machine's windows: ${found.model_error.reason}`)
        : null,
      h(
        "div",
        { class: "controls" },
        note,
        h(
          "button",
          { type: "button", "data-key": "accept", onclick: once(() => accept(found.proposal, note.value)) },
          "Accept with the new thresholds",
        ),
        h(
          "button",
          { type: "button", class: "quiet", "data-key": "accept-keep", onclick: once(() => accept(null, note.value)) },
          "Accept, keep the thresholds",
        ),
      ),
    ];
  }

  show(place, h("p", { class: "muted" }, "Its healthy windows give new thresholds; nothing changes before you accept."));
  return panel(
    "Accept for a machine",
    null,
    h(
      "div",
      { class: "stack" },
      h(
        "div",
        { class: "controls" },
        h("label", { for: "machine" }, "machine"),
        select,
        h("button", { type: "button", class: "quiet", "data-key": "propose", onclick: propose }, "Derive thresholds"),
      ),
      place,
    ),
  );
}

function thresholdTable(found) {
  const rows = [
    ...Object.entries(found.thresholds).map(([name, each]) => [`Threshold of ${title(name)}`, each]),
    ...Object.entries(found.model_error.outputs).map(([name, each]) => [
      `Largest healthy model error of ${name} (RMS of a window, passed by one in a thousand)`,
      each,
    ]),
  ];
  return h(
    "table",
    { class: "reflow" },
    tableHead(HEADS, [1, 2]),
    h(
      "tbody",
      {},
      rows.map(([what, each]) =>
        h(
          "tr",
          {},
          h("td", { "data-label": HEADS[0] }, what),
          h("td", { "data-label": HEADS[1], class: "number" }, quantity(each.old, each.unit, each.new)),
          h("td", { "data-label": HEADS[2], class: "number" }, quantity(each.new, each.unit, each.old)),
        ),
      ),
    ),
  );
}

// What a machine's page says of its model: the active version, and all that were accepted before.
export async function activeModel(asset) {
  try {
    const { active, history } = await call(path("assets", asset, "model"));
    if (!active) return null;
    return panel(
      "Model",
      h("a", { href: `#/workbench?model=${encodeURIComponent(active.model)}&version=${active.number}` }, "open on the workbench"),
      h(
        "ul",
        { class: "plain" },
        history.map((version) =>
          h(
            "li",
            {},
            h("span", {}, version.note),
            " ",
            h("span", { class: "muted small" }, `accepted ${moment(version.created_at)} by ${version.created_by ?? "–"}`),
          ),
        ),
      ),
    );
  } catch (problem) {
    notify(problem.message);
    return null;
  }
}
