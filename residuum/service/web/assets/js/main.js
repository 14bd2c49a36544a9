// Start: theme, connection, pages by address (#/ and #/machines/NAME).

import { apiKey } from "./lib/api.js";
import { h, notify, refresh, reveal, show } from "./lib/dom.js";
import { readEffectTitles } from "./lib/effect_titles.js";
import { assetTitle } from "./lib/format.js";
import { Live } from "./lib/live.js";
import { plant, readAll, readStatus, subscribe, take } from "./lib/plant_state.js";
import { savePicture, saveReport } from "./lib/report_file.js";
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
  [/^#\/effects$/, (place) => effectsPage(place)],
  [/^#\/failure-modes(?:\?(.*))?$/, (place) => risksPage(place)],
  [/^(#\/?)?$/, (place) => plantPage(place)],
];
const MOST_LINKED = 6;
const main = document.getElementById("main");
let leave = null;

function open() {
  const page = PAGES.find(([pattern]) => pattern.test(location.hash)) ?? PAGES.at(-1);
  leave?.();
  leave = page[1](main, ...(page[0].exec(location.hash)?.slice(1) ?? []));
  navigation();
}

function navigation() {
  const machines = [...plant.assets.values()];
  const few = machines.length <= MOST_LINKED ? machines : [];
  const links = [
    ["#/", "Plant"],
    ["#/watch", "Watch a machine"],
    ["#/workbench", "Workbench"],
    ["#/identify", "Identify"],
    ["#/control", "Control"],
    ["#/effects", "Effects"],
    ["#/failure-modes", "Failure modes"],
    ...few.map((asset) => [`#/machines/${encodeURIComponent(asset.id)}`, assetTitle(asset)]),
  ];
  const here = (location.hash || "#/").split("?")[0];
  const nav = document.getElementById("nav");
  refresh(nav, () =>
    links.map(([address, text]) =>
      h("a", { href: address, "data-key": address, "aria-current": address === here ? "page" : null }, text.slice(0, 40)),
    ),
  );
  reveal(nav, nav.querySelector("[aria-current]"));
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
  place.textContent = state === "live" ? "live" : "connection lost, trying again …";
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

function askForKey() {
  const input = h("input", { type: "password", autocomplete: "off", id: "key", required: true });
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
  document.addEventListener("key-needed", () => {
    if (!asked) askForKey();
    asked = true;
  });
  try {
    await Promise.all([readAll(), readEffectTitles()]);
  } catch (problem) {
    if (problem.status === 401) return;
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
      if (state === "live" && !resumed) reread();
    },
  );
  setInterval(() => {
    if (!document.hidden) readStatus().catch(() => {});
  }, 2000);
}

start();
