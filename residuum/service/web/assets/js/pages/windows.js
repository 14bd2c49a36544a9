// The last windows of a machine: choose one, see its signal (zooming asks the server anew) and one more picture of it.

import { draw, forget, signalTraces } from "../charts/charts.js";
import { VIEWS } from "../charts/window_views.js";
import { call, path } from "../lib/api.js";
import { h, notify, refresh, show } from "../lib/dom.js";
import { inBrackets, moment, span, time } from "../lib/format.js";
import { icon, methodsLine, sentence, stateName, stateOf, tone } from "../lib/parts.js";
import { hasView, plant } from "../lib/plant_state.js";
import { drawFound } from "./found.js";
import { whyAddress } from "./why_address.js";

const LISTED = 50;
const EXPLAIN = "Explain this window on the workbench";

// `asked` is a window that the address names: it is shown, instead of the latest.
// `looked` is told the finding of a chosen window, null while the latest is followed.
export function windowsPanel(asset, asked = null, looked = () => {}) {
  const list = h("div", { class: "picker", role: "group", "aria-label": "Windows" });
  const signalChart = h("div", { class: "chart", role: "figure", "aria-label": "Signal" });
  const pictures = h("div");
  const channel = h("select", { "aria-label": "Channel", "data-key": "channel", onchange: () => drawWindow() });
  const follow = h("input", {
    type: "checkbox",
    "data-key": "follow",
    onchange: () => follow.checked && choose(findings[0]?.window),
  });
  follow.checked = asked === null;
  const views = Object.entries(VIEWS).filter(([, { own, address }]) => !own || hasView(asset, address));
  const view = h(
    "select",
    { "aria-label": "Picture", "data-key": "picture", onchange: () => drawWindow() },
    views.map(([id, { title }]) => h("option", { value: id }, title)),
  );
  const caption = h("p", { class: "muted" });
  const said = h("div");
  const found = h("div");
  const why = hasView(asset, "tracks")
    ? h(
        "p",
        { class: "controls" },
        h("button", { type: "button", class: "quiet", "data-key": "explain-window", onclick: explain }, EXPLAIN),
        h("span", { class: "muted small" }, "It estimates values anew: one that changed is no missing effect."),
      )
    : null;
  const element = h(
    "section",
    { class: "panel" },
    h(
      "header",
      {},
      h("h2", {}, "Windows"),
      h(
        "div",
        { class: "controls" },
        h("label", {}, follow, "follow the latest"),
        h("label", {}, "channel", channel),
        h("label", {}, "below", view),
      ),
    ),
    h(
      "div",
      { class: "body columns" },
      h("div", { class: "span-4" }, list),
      h("div", { class: "span-8" }, caption, said, found, why, signalChart, pictures),
    ),
  );
  let findings = [];
  let chosen = asked;
  let drawn = null; // the window whose signal is shown
  let meanwhile = null; // findings that came during the newest reading
  let stop = new AbortController();

  async function read() {
    const came = [];
    meanwhile = came;
    const listed = !plant.assets.has(asset)
      ? []
      : await call(`${path("assets", asset, "findings")}?limit=${LISTED}`).then(
          ({ items }) => items,
          (problem) => notify(problem.message) ?? [],
        );
    if (came !== meanwhile) return; // a later reading is under way
    meanwhile = null;
    findings = [...came.filter((finding) => !listed.some((each) => each.window === finding.window)), ...listed].slice(0, LISTED);
    drawList();
    const wanted = follow.checked || chosen === null ? findings[0]?.window : chosen;
    if (wanted === undefined) caption.textContent = "No window yet.";
    else if (wanted !== drawn) choose(wanted); // what is shown, and zoomed into, stays
  }

  function drawList() {
    refresh(list, () =>
      findings.map((finding) =>
        h(
          "button",
          {
            type: "button",
            "aria-pressed": String(finding.window === chosen),
            "data-key": `window-${finding.window}`,
            title: sentence(finding),
            onclick: () => {
              follow.checked = finding.window === findings[0].window;
              choose(finding.window);
            },
          },
          h("span", { class: `tone-${tone(stateOf(finding))}` }, icon(stateOf(finding))),
          h("span", {}, stateName(stateOf(finding)), finding.class ? `: ${finding.class}` : ""),
          h("span", { class: "muted number", title: moment(finding.at) }, time(finding.at)),
        ),
      ),
    );
  }

  async function explain() {
    if (chosen === null) return;
    try {
      location.hash = await whyAddress(asset, [chosen]);
    } catch (problem) {
      notify(problem.message);
    }
  }

  async function choose(window) {
    if (window === undefined || window === null) return;
    chosen = window;
    drawList();
    show(said, methodsLine(findings.find((finding) => finding.window === window)));
    await drawWindow();
  }

  async function drawWindow(range = null) {
    if (chosen === null) return; // a picture was chosen before the list of windows came
    stop.abort();
    stop = new AbortController();
    const { signal: stopped } = stop;
    const address = path("assets", asset, "windows", chosen);
    try {
      const { window, finding } = await call(address, { signal: stopped });
      looked(follow.checked ? null : finding);
      if (!range) drawFound(found, asset, finding);
      chooseChannel(window);
      caption.textContent =
        `Window ${window.id}: ${window.n.toLocaleString()} samples at ` +
        `${(1 / window.sample_time).toLocaleString()} Hz, ${span(window.n * window.sample_time)}, received ` +
        `${moment(window.received_at)}`;
      const gone = window.signal_let_go_at;
      signalChart.hidden = pictures.hidden = Boolean(gone);
      if (gone) {
        caption.textContent += `. Its signal was let go on ${moment(gone)} by the retention rule; what was found is kept.`;
        return;
      }
      const query = `channel=${encodeURIComponent(channel.value)}`;
      const cut = range ? `&from=${Math.max(0, range[0])}&to=${Math.max(range[1], 1e-9)}` : "";
      const signal = await call(`${address}/signal?${query}${cut}`, { signal: stopped });
      await plot(window, signal);
      if (stopped.aborted) return;
      drawn = window.id;
      if (!range) await picture(address, query, window, stopped);
    } catch (problem) {
      if (problem.status === 410) caption.textContent = problem.message;
      else if (problem.name !== "AbortError") notify(problem.message);
    }
  }

  function chooseChannel(window) {
    const names = Object.keys(window.units);
    if (names.join("\n") === [...channel.options].map((option) => option.value).join("\n")) return;
    const before = channel.value;
    show(
      channel,
      names.map((name) => h("option", { value: name }, name)),
    );
    channel.value = names.includes(before) ? before : (names.find((name) => name === "y") ?? names[0]);
  }

  async function plot(window, signal) {
    const x = { title: { text: "time [s]" }, exponentformat: "SI" };
    const y = { title: { text: `${channel.value}${inBrackets(window.units[channel.value])}` }, exponentformat: "SI" };
    await draw(signalChart, signalTraces(signal, channel.value), {
      x,
      y,
      more: { uirevision: `${window.id} ${channel.value}` },
      onZoom: drawWindow,
    });
  }

  // A chart of its own a picture: axes of one would linger in the next.
  async function picture(address, query, window, stopped) {
    const { title, address: noun, draw: drawPicture } = VIEWS[view.value];
    if (pictures.dataset.view !== view.value) {
      for (const chart of pictures.children) forget(chart);
      show(pictures, h("div", { class: "chart", role: "figure", "aria-label": title }));
      pictures.dataset.view = view.value;
    }
    const found = await call(`${address}/${noun}?${query}`, { signal: stopped });
    await drawPicture(pictures.firstChild, found, window.units[channel.value] ?? "");
  }

  function add(finding) {
    meanwhile?.unshift(finding);
    findings = [finding, ...findings].slice(0, LISTED);
    drawList();
    if (follow.checked || chosen === null) choose(finding.window);
  }

  if (asked !== null) setTimeout(() => element.scrollIntoView(), 0); // when the page stands
  read();
  return {
    element,
    add,
    read,
    leave: () => {
      stop.abort();
      forget(signalChart);
      for (const chart of pictures.children) forget(chart);
    },
  };
}
