// The picture of an effect's signature: a small curve with its axes, drawn as SVG.

import { h } from "../lib/dom.js";
import { inBrackets, number, title } from "../lib/format.js";

const [WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM] = [320, 170, 58, 10, 20, 34];
const MARGIN = 0.06;

function scale(values, from, to) {
  const [least, most] = [Math.min(0, ...values), Math.max(0, ...values)];
  const span = most - least || 1;
  return { least, most, at: (value) => from + ((value - least + MARGIN * span) / (span * (1 + 2 * MARGIN))) * (to - from) };
}

const BALANCES = {
  torque: "torque",
  force: "force",
  voltage: "voltage",
  heat: "heat flow",
  volume: "flow",
  input: "input after it",
  output: "output after it",
};

export function signaturePicture(name, drawn) {
  const x = scale(drawn.at, LEFT, WIDTH - RIGHT);
  const y = scale([...drawn.value, ...(drawn.before ?? [])], HEIGHT - BOTTOM, TOP);
  const points = (values) =>
    values.map((value, index) => `${x.at(drawn.at[index]).toFixed(1)},${y.at(value).toFixed(1)}`).join(" ");
  const across = `${title(drawn.axis)}${drawn.axis === "signal" ? " before it" : ""}${inBrackets(drawn.axis_unit)}`;
  const up = `${BALANCES[drawn.kind] ?? drawn.kind}${inBrackets(drawn.unit)}`;
  const text = (at, kind, ...content) => h("svg:text", { ...at, class: kind }, ...content);
  const ends = [x.least, x.most]
    .filter((value) => value)
    .map((value) =>
      text({ x: x.at(value), y: HEIGHT - BOTTOM + 14, "text-anchor": value === x.most ? "end" : "start" }, "tick", number(value)),
    );
  const heights = [y.least, y.most]
    .filter((value) => value)
    .map((value) => text({ x: LEFT - 4, y: y.at(value) + 4, "text-anchor": "end" }, "tick", number(value)));
  return h(
    "svg:svg",
    {
      class: "signature",
      viewBox: `0 0 ${WIDTH} ${HEIGHT}`,
      role: "img",
      "aria-label": `Signature of ${name}: ${up} over ${across}`,
    },
    h("svg:line", { class: "axis", x1: LEFT, x2: WIDTH - RIGHT, y1: y.at(0), y2: y.at(0) }),
    h("svg:line", { class: "axis", x1: x.at(0), x2: x.at(0), y1: TOP, y2: HEIGHT - BOTTOM }),
    text({ x: LEFT - 4, y: y.at(0) + 4, "text-anchor": "end" }, "tick", "0"),
    heights,
    ends,
    drawn.before ? h("svg:polyline", { class: "before", points: points(drawn.before) }) : null,
    h("svg:polyline", { class: "curve", points: points(drawn.value) }),
    text({ x: WIDTH - RIGHT, y: HEIGHT - 5, "text-anchor": "end" }, "label", across),
    text({ x: 2, y: 12 }, "label", up),
  );
}
