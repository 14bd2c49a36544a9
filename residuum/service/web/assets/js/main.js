// Start: theme, connection, pages by address (#/ and #/machines/NAME).

import { apiKey } from "./lib/api.js";
import { h, notify, refresh, show } from "./lib/dom.js";
import { readEffectTitles } from "./lib/effect_titles.js";
import { assetTitle, capital } from "./lib/format.js";
import { Live } from "./lib/live.js";
import { machinesOfPlant, readAll, readStatus, subscribe, take } from "./lib/plant_state.js";
import { savePicture, saveReport } from "./lib/report_file.js";
import { interfacePage, settingsPage } from "./pages/about.js";
import { alarmHistoryPage } from "./pages/alarm_history.js";
import { bearingPage } from "./pages/bearing.js";
import { controlPage } from "./pages/control.js";
import { effectsPage } from "./pages/effects.js";
import { identifyPage } from "./pages/identify.js";
import { machinePage } from "./pages/machine.js";
import { plantPage } from "./pages/plant.js";
import { risksPage } from "./pages/risks.js";
import { workbenchPage } from "./pages/workbench.js";
import { watchPage } from "./watch/page.js";

const PAGES = [
  [/^#\/machines\/([^?]+)(?:\?(.*))?$/, (place, name, query) => machinePage(place, decodeURIComponent(name), query)],
  [/^#\/watch(?:\?(.*))?$/, (place, query) => watchPage(place, query)],
  [/^#\/workbench(?:\?(.*))?$/, (place, query) => workbenchPage(place, query)],
  [/^#\/identify(?:\?(.*))?$/, (place, query) => identifyPage(place, query)],
  [/^#\/control(?:\?(.*))?$/, (place, query) => controlPage(place, query)],
  [/^#\/alarms(?:\?(.*))?$/, (place, query) => alarmHistoryPage(place, query)],
  [/^#\/bearing(?:\?(.*))?$/, (place, query) => bearingPage(place, query)],
  [/^#\/interface$/, (place) => interfacePage(place)],
  [/^#\/settings$/, (place) => settingsPage(place)],
  [/^#\/effects$/, (place) => effectsPage(place)],
  [/^#\/failure-modes(?:\?(.*))?$/, (place) => risksPage(place)],
  [/^(#\/?)?$/, (place) => plantPage(place)],
];
const CONNECTION = { connected: "connected", locked: "no key, no events", lost: "connection lost, trying again …" };
const main = document.getElementById("main");
let leave = null;

function open() {
  const page = PAGES.find(([pattern]) => pattern.test(location.hash)) ?? PAGES.at(-1);
  leave?.();
  leave = page[1](main, ...(page[0].exec(location.hash)?.slice(1) ?? []));
  navigation();
}

function navigation() {
  const links = [
    ["#/", "Plant"],
    ["#/alarms", "Alarms"],
    ["#/watch", "Watch a machine"],
    ["#/workbench", "Workbench"],
    ["#/identify", "Identify"],
    ["#/control", "Control"],
    ["#/bearing", "Bearing"],
    ["#/effects", "Effects"],
    ["#/failure-modes", "Failure modes"],
  ];
  const here = (location.hash || "#/").split("?")[0];
  refresh(document.getElementById("nav"), () => [
    links.map(([address, text]) =>
      h("a", { href: address, "data-key": address, "aria-current": address === here ? "page" : null }, text),
    ),
    machineChoice(here),
  ]);
}

// One choice for however many machines: it takes the same room for three as for three hundred.
function machineChoice(here) {
  const machines = machinesOfPlant().map(([asset]) => [`#/machines/${encodeURIComponent(asset.id)}`, assetTitle(asset)]);
  if (!machines.length) return null;
  const go = (event) => {
    if (event.target.value) location.hash = event.target.value;
  };
  const chosen = machines.some(([address]) => address === here);
  const options = machines.map(([value, text]) => h("option", { value, selected: value === here }, text.slice(0, 40)));
  return h(
    "select",
    { "aria-label": "Machine", "data-key": "machine", "data-chosen": chosen, onchange: go },
    h("option", { value: "" }, `Machine … (${machines.length})`),
    options,
  );
}

function theme() {
  const button = document.getElementById("theme");
  const system = matchMedia("(prefers-color-scheme: dark)");
  const order = ["auto", "light", "dark"];
  const apply = () => {
    const chosen = localStorage.getItem("residuum-theme") ?? "auto";
    document.documentElement.dataset.theme = chosen === "auto" ? (system.matches ? "dark" : "light") : chosen;
    button.textContent = `Theme: ${chosen}`;
    return chosen;
  };
  button.addEventListener("click", () => {
    localStorage.setItem("residuum-theme", order[(order.indexOf(apply()) + 1) % 3]);
    apply();
    open();
  });
  system.addEventListener("change", () => {
    apply();
    open();
  });
  apply();
}

function connection(state) {
  const place = document.getElementById("connection");
  if (place.dataset.state === state) return;
  place.dataset.state = state;
  place.textContent = CONNECTION[state];
}

// The view of now as a file, named after its address.
function reports() {
  const name = () =>
    (location.hash.replace(/^#\/?/, "").split("?")[0] || "plant").replaceAll(/[^A-Za-z0-9._-]+/g, "-") +
    (/[?&]step=([a-z]+)/.exec(location.hash)?.[1] ?? "").replace(/^(.)/, "-$1");
  for (const [id, save] of [
    ["save-html", saveReport],
    ["save-png", savePicture],
  ])
    document.getElementById(id).addEventListener("click", () => save(main, name()).catch((problem) => notify(problem.message)));
}

// `refusal` is what the service says of the key that it was shown: one that it does not know, or whose role may not read.
function askForKey(refusal) {
  const given = apiKey.get();
  const input = h("input", {
    type: "password",
    autocomplete: "off",
    id: "key",
    required: true,
    pattern: "[!-~]+",
    title: "Letters, digits and signs of ASCII, without a space",
    "aria-describedby": given ? "key-refused" : null,
  });
  const form = h(
    "form",
    {
      class: "panel key-form",
      onsubmit: (event) => {
        event.preventDefault();
        apiKey.set(input.value.trim());
        location.reload();
      },
    },
    h("h1", {}, "API key"),
    h("label", { for: "key" }, "This service asks for a key. It is kept until this tab is closed."),
    input,
    given ? h("p", { id: "key-refused", class: "above", role: "alert" }, `${capital(refusal)}. Enter another key.`) : null,
    h("button", {}, "Continue"),
  );
  leave?.();
  leave = null;
  show(main, form);
  input.focus();
}

async function start() {
  theme();
  reports();
  let asked = false;
  const ask = (refusal) => {
    connection("locked");
    if (!asked) askForKey(refusal.replace(/[.]$/, ""));
    asked = true;
  };
  document.addEventListener("key-needed", (event) => ask(event.detail));
  try {
    await Promise.all([readAll(), readEffectTitles()]);
  } catch (problem) {
    if (problem.status === 403) ask(problem.message);
    if (asked) return;
    notify(problem.message);
  }
  open();
  window.addEventListener("hashchange", () => {
    open();
    main.focus({ preventScroll: true });
    scrollTo(0, 0);
  });
  subscribe((kind) => (kind === "all" ? navigation() : null));
  const reread = () => readAll().catch((problem) => notify(problem.message));
  new Live(
    (kind, payload) => take(kind, payload)?.catch?.((problem) => notify(problem.message)),
    (state, resumed) => {
      connection(state);
      if (state === "connected" && !resumed) reread();
    },
  );
  setInterval(() => {
    if (!document.hidden) readStatus().catch(() => {});
  }, 2000);
}

start();
