// Step 7: the machine is watched: the finding of now, its alarms, and where to go on.

import { h, panel, refresh, show } from "../lib/dom.js";
import { ago } from "../lib/format.js";
import { badge, methodsLine, sentence } from "../lib/parts.js";
import { plant, readAll, subscribe } from "../lib/plant_state.js";
import { alarmList } from "../pages/alarms.js";

export async function watchingStep(place, way) {
  const now = h("div", { class: "stack" });
  const alarms = h("div");
  const page = `#/machines/${encodeURIComponent(way.machine)}`;
  show(
    place,
    panel(`${way.machine} is watched`, h("a", { href: page, "data-key": "machine-page" }, "the machine's page"), now),
    panel("Alarms", null, alarms),
  );
  if (!plant.assets.has(way.machine)) await readAll();
  const draw = () => {
    const asset = plant.assets.get(way.machine);
    const finding = asset?.last_finding;
    const machine = plant.status.machines?.[way.machine] ?? null;
    const judged = finding && asset.state !== "no-baseline";
    refresh(now, () => [
      h("div", { class: "title" }, badge(judged ? asset.state : "no-baseline")),
      h(
        "p",
        { class: "says-large" },
        judged ? sentence(finding) : capital(machine?.doing ?? "waiting for the first window that is judged"),
      ),
      judged ? methodsLine(finding) : null,
      judged ? h("p", { class: "muted" }, `Window ${finding.window}, ${ago(finding.at)}.`) : null,
    ]);
    refresh(alarms, () =>
      alarmList(
        [...plant.alarms.values()].filter((alarm) => alarm.asset === way.machine),
        { withAsset: false },
      ),
    );
  };
  way.leaving.push(subscribe(draw));
  draw();
}

const capital = (text) => `${text.charAt(0).toUpperCase()}${text.slice(1)}.`;
