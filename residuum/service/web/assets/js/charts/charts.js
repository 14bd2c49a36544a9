// Charts by Plotly, loaded when the first one is drawn; colours from the page's theme.

let loading = null;
const drawn = new Set();

// Plotly puts a map library's style element into the page unless one with this id is there; the page's policy forbids it.
const MAP_STYLE = "9f215cf04c5486422605d13261cb87401f4e7763b6296af81e98efbc0130da53";

function plotly() {
  loading ??= new Promise((resolve, reject) => {
    const guard = document.createElement("meta");
    guard.id = MAP_STYLE;
    const script = document.createElement("script");
    script.src = "/vendor/plotly.min.js";
    script.onload = () => resolve(window.Plotly);
    script.onerror = () => {
      loading = null; // the next chart asks again
      guard.remove();
      script.remove();
      reject(new Error("The chart library could not be loaded."));
    };
    document.head.append(guard, script);
  });
  return loading;
}

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
export const series = () => ["--series-1", "--series-2", "--series-3", "--series-4"].map(colour);
export const tones = () => ({
  healthy: colour("--healthy"),
  faulty: colour("--faulty"),
  "not-assessable": colour("--unsure"),
  limit: colour("--text"),
});

function layout(x, y, y2, y3, more) {
  const axis = {
    gridcolor: colour("--line"),
    linecolor: colour("--line-strong"),
    zerolinecolor: colour("--line"),
    ticks: "outside",
    tickcolor: colour("--line-strong"),
    automargin: true,
  };
  return {
    paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)",
    font: { family: getComputedStyle(document.body).fontFamily, size: 12, color: colour("--text") },
    margin: { l: 56, r: 12, t: 8, b: 42 },
    showlegend: false,
    modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("--muted"), activecolor: colour("--text") },
    hovermode: "closest",
    dragmode: "zoom",
    separators: (1.1).toLocaleString().charAt(1) === "," ? ",." : ".,",
    xaxis: { ...axis, ...x },
    yaxis: { ...axis, ...y },
    ...(y2 ? { yaxis2: { ...axis, ...y2 } } : {}),
    ...(y3 ? { yaxis3: { ...axis, ...y3 } } : {}),
    ...more,
  };
}

// A name from outside as text: Plotly would read its tags as markup.
const LONGEST = 120;
export const literal = (text) =>
  typeof text === "string"
    ? (text.length > LONGEST ? `${text.slice(0, LONGEST)}…` : text).replaceAll("&", "&amp;").replaceAll("<", "&lt;")
    : text;
const titled = (axis) => (axis?.title?.text ? { ...axis, title: { ...axis.title, text: literal(axis.title.text) } } : axis);
const named = (trace) => ({
  ...trace,
  ...("name" in trace ? { name: literal(trace.name) } : {}),
  ...(Array.isArray(trace.text) ? { text: trace.text.map(literal) } : {}),
});
const noted = (more) =>
  more.annotations ? { ...more, annotations: more.annotations.map((each) => ({ ...each, text: literal(each.text) })) } : more;

export async function draw(place, traces, { x = {}, y = {}, y2 = null, y3 = null, more = {}, onZoom = null } = {}) {
  const library = await plotly();
  if (!place.isConnected) return;
  await library.react(place, traces.map(named), layout(titled(x), titled(y), titled(y2), titled(y3), noted(more)), {
    displaylogo: false,
    responsive: true,
    displayModeBar: "hover",
    modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"],
  });
  if (onZoom && place.on && !drawn.has(place)) {
    // its page may have been left in the meantime
    drawn.add(place);
    place.on("plotly_relayout", (change) => {
      if ("xaxis.range[0]" in change)
        place.dispatchEvent(new CustomEvent("zoom", { detail: [change["xaxis.range[0]"], change["xaxis.range[1]"]] }));
      else if (change["xaxis.autorange"]) place.dispatchEvent(new CustomEvent("zoom", { detail: null }));
    });
    place.addEventListener("zoom", (event) => onZoom(event.detail));
  }
}

export function forget(place) {
  drawn.delete(place);
  if (window.Plotly) window.Plotly.purge(place);
}

// A line through samples, or the band between minimum and maximum of every interval, drawn so that no peak is lost.
export function signalTraces(signal, name, colour = series()[0], more = {}) {
  const channel = signal.channels[name];
  const at = (index, offset = 0) => signal.start + (index + offset) * signal.interval;
  if (!signal.reduced)
    return [
      {
        type: "scatter",
        mode: "lines",
        x: channel.values.map((_, index) => at(index)),
        y: channel.values,
        line: { width: 1.2, color: colour },
        connectgaps: false,
        hovertemplate: "%{x:.6~g} s<br>%{y:.5~g}<extra></extra>",
        ...more,
      },
    ];
  const x = [];
  const y = [];
  channel.minimum.forEach((lowest, index) => {
    x.push(at(index, 0.25), at(index, 0.75));
    y.push(lowest, channel.maximum[index]);
  });
  return [
    {
      type: "scatter",
      mode: "lines",
      x,
      y,
      line: { width: 1, color: colour },
      connectgaps: false,
      hovertemplate: "%{x:.6~g} s<br>%{y:.5~g}<extra></extra>",
      ...more,
    },
  ];
}
