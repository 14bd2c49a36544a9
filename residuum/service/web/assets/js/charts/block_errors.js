// The error of an output block by block, on blocks that no fit has seen: as it is, with candidates, with all that was found.

import { h } from "../lib/dom.js";
import { inBrackets } from "../lib/format.js";
import { draw, series, tones } from "./charts.js";

const COMPARED = 3;

// Times begin anew in every record: several are drawn block after block.
export function drawBlockErrors(chart, { blocks, outputs }, name, titles) {
  const output = outputs.find((each) => each.output === name);
  const several = blocks.at(-1).record > 0;
  const edges = blocks.flatMap((block, index) => (several ? [index, index + 1] : [block.from, block.to]));
  const [blue, orange, green, purple] = series();
  const line = (label, errors, color, dash) => ({
    type: "scatter",
    mode: "lines",
    name: label,
    x: edges,
    y: errors.flatMap((error) => [error, error]),
    line: { color, width: 2, dash },
    connectgaps: false,
    hovertemplate: "%{y:.4~g}<extra></extra>",
  });
  const candidates = output.candidates.slice(0, COMPARED);
  const traces = [
    line("the model as it is", output.before, blue, "solid"),
    ...candidates.map((each, index) =>
      line(`with ${titles.get(each.effect)?.title ?? each.effect}`, each.error, [orange, green, purple][index], "dash"),
    ),
    line("with all that was found", output.after, tones().limit, "dot"),
  ];
  return draw(chart, traces, {
    x: { title: { text: several ? "block, records one after the other" : "time [s]" }, exponentformat: "SI" },
    y: { title: { text: `RMS error of ${name}${inBrackets(output.unit)}` }, exponentformat: "SI", rangemode: "tozero" },
    more: {
      showlegend: true,
      legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 },
      margin: { l: 64, r: 12, t: 44, b: 42 },
    },
  });
}

export const blockErrorsChart = (label) => h("div", { class: "chart", role: "figure", "aria-label": label });
