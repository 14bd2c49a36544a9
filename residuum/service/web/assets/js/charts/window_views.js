// Pictures of a window below its signal: spectra, envelope spectrum, kurtogram, residual with its threshold.

import { inBrackets, number, quantity } from "../lib/format.js";
import { draw, series, tones } from "./charts.js";

const HERTZ = { title: { text: "frequency [Hz]" }, exponentformat: "SI" };
const LEGEND = {
  showlegend: true,
  legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 },
  margin: { l: 64, r: 12, t: 34, b: 42 },
};

// `own` = a picture that only some diagnosers have; the service says which.
export const VIEWS = {
  decades: {
    title: "Amplitude spectrum",
    address: "spectrum",
    draw: (place, found, unit) => spectrum(place, found, unit, { type: "log", range: decades(found.amplitude) }),
  },
  linear: {
    title: "Amplitude spectrum, linear",
    address: "spectrum",
    draw: (place, found, unit) => spectrum(place, found, unit, { rangemode: "tozero" }),
  },
  envelope: { title: "Envelope spectrum", address: "envelope", draw: envelope },
  kurtogram: { title: "Kurtogram", address: "kurtogram", draw: kurtogram },
  residual: { title: "Residual", address: "residual", draw: residual, own: true },
};

// From the largest amplitude down by at most five decades: below lies rounding.
function decades(amplitude) {
  const largest = Math.log10(Math.max(...amplitude)) || 0;
  const floor = Math.log10(Math.min(...amplitude.filter((value) => value > 0))) || 0;
  return [Math.max(floor, largest - 5) - 0.1, largest + 0.2];
}

const line = (x, y, colour, unit) => ({
  type: "scatter",
  mode: "lines",
  x,
  y,
  line: { width: 1, color: colour },
  hovertemplate: `%{x:.5~g} ${unit}<br>%{y:.4~g}<extra></extra>`,
});
const note = (text) => ({
  text,
  xref: "paper",
  yref: "paper",
  x: 1,
  y: 1,
  xanchor: "right",
  yanchor: "bottom",
  showarrow: false,
});

function spectrum(place, found, unit, scale) {
  return draw(
    place,
    [
      line(
        found.amplitude.map((_, index) => index * found.step),
        found.amplitude,
        series()[2],
        "Hz",
      ),
    ],
    { x: HERTZ, y: { title: { text: `amplitude${inBrackets(unit)}` }, exponentformat: "SI", ...scale } },
  );
}

function envelope(place, found, unit) {
  const at = found.amplitude.map((_, index) => (index + 1) * found.step);
  return draw(place, [line(at, found.amplitude, series()[2], "Hz")], {
    x: HERTZ,
    y: { title: { text: `envelope${inBrackets(unit)}` }, exponentformat: "SI", rangemode: "tozero" },
    more: {
      margin: { l: 64, r: 12, t: 28, b: 42 },
      annotations: [note(`of the band ${quantity(found.low, "Hz")} … ${quantity(found.high, "Hz")}`)],
    },
  });
}

// A bar a band, coloured by its kurtosis. (Plotly's heat map and colour bar would need inline styles, which the page's policy
// forbids.)
function kurtogram(place, { level, frequency, kurtosis, best }) {
  const bands = [];
  const column = frequency[1] - frequency[0];
  kurtosis.forEach((row, index) => {
    let begin = 0;
    row.forEach((value, at) => {
      if (at + 1 < row.length && row[at + 1] === value) return;
      bands.push({ level: number(level[index]), low: begin * column, width: (at + 1 - begin) * column, value });
      begin = at + 1;
    });
  });
  const of = (name) => bands.map((band) => band[name]);
  const bars = {
    type: "bar",
    orientation: "h",
    base: of("low"),
    x: of("width"),
    y: of("level"),
    customdata: of("value"),
    hovertemplate: "%{base:.4~g} Hz, %{x:.4~g} Hz wide<br>kurtosis %{customdata:.3~g}<extra></extra>",
    marker: { color: of("value"), colorscale: "Viridis", line: { width: 0 } },
  };
  return draw(place, [bars], {
    x: HERTZ,
    y: { title: { text: "level" }, type: "category", autorange: "reversed", categoryarray: level.map((each) => number(each)) },
    more: {
      bargap: 0,
      barmode: "overlay",
      margin: { l: 64, r: 12, t: 28, b: 42 },
      annotations: [
        note(
          `kurtosis ${number(Math.min(...of("value")))} (dark) … ${number(best.kurtosis)} (bright), the largest at ` +
            `${quantity(best.centre, "Hz")}, ${quantity(best.width, "Hz")} wide`,
        ),
      ],
    },
  });
}

function residual(place, { time, lowest, highest, statistic, threshold, unit }) {
  const [blue, orange] = series();
  const x = time.flatMap((each) => [each, each]);
  const y = time.flatMap((_, index) => [lowest[index], highest[index]]);
  const ends = [time[0], time.at(-1)];
  const traces = [
    { ...line(x, y, blue, "s"), name: `residual${inBrackets(unit)}` },
    { ...line(time, statistic, orange, "s"), name: "statistic", yaxis: "y2" },
    {
      type: "scatter",
      mode: "lines",
      x: ends,
      y: [threshold, threshold],
      yaxis: "y2",
      name: "threshold",
      line: { dash: "dash", width: 1.5, color: tones().limit },
      hovertemplate: "threshold %{y:.4~g}<extra></extra>",
    },
  ];
  return draw(place, traces, {
    x: { title: { text: "time [s]" }, exponentformat: "SI", anchor: "y2" },
    y: { title: { text: `residual${inBrackets(unit)}` }, domain: [0.55, 1], exponentformat: "SI" },
    y2: { title: { text: "statistic [σ]" }, domain: [0, 0.45], rangemode: "tozero" },
    more: LEGEND,
  });
}
