// Any view as one HTML file that opens offline, or as a picture: its text as it is, its charts as pictures, its style inside.

const STYLES = ["tokens", "base", "parts", "workbench"];
const SCALE = 2;
const CHART = ".js-plotly-plot";
const CHARTS =
  ".chart, .chart.overlay, .chart.cloud, .chart.tall { height: auto; } .chart img { max-width: 100%; height: auto; }";
const WHOLE = ".scroll, .regions, .picker, .choices { overflow: visible; max-height: none; }";

function element(tag, text) {
  const made = document.createElement(tag);
  made.textContent = text;
  return made;
}

// A copy of the view that needs neither scripts nor server.
async function frozen(place) {
  const copy = place.cloneNode(true);
  const all = [...copy.querySelectorAll("*")];
  const twins = [...place.querySelectorAll("*")].map((one, index) => [one, all[index]]);
  const pairs = (selector) => twins.filter(([one]) => one.matches(selector) && (selector === CHART || !one.closest(CHART)));
  for (const [chart, twin] of pairs(CHART)) {
    const { width, height } = chart.getBoundingClientRect();
    if (!width) continue;
    const picture = document.createElement("img");
    picture.src = await window.Plotly.toImage(chart, { format: "png", width, height, scale: SCALE });
    picture.width = width;
    picture.alt = chart.getAttribute("aria-label") ?? "";
    twin.replaceChildren(picture);
    twin.removeAttribute("style");
  }
  for (const [control, twin] of pairs("select")) twin.replaceWith(element("b", control.selectedOptions[0]?.textContent ?? ""));
  for (const [control, twin] of pairs("input, textarea"))
    twin.replaceWith(
      element("b", control.type === "checkbox" ? (control.checked ? "yes" : "no") : control.type === "file" ? "" : control.value),
    );
  for (const [control, twin] of pairs("button")) {
    if (
      control.matches("[role=tab]:not([aria-selected=true])") ||
      !control.matches("[role=tab], .cell, .region, .link, .picker *")
    )
      twin.remove();
    else twin.replaceWith(replica(control, twin));
  }
  for (const drop of copy.querySelectorAll(".drop")) drop.remove();
  const origin = element("p", `${new Date().toLocaleString()} · ${location.href}`);
  origin.className = "muted small";
  copy.append(origin);
  const styles = await Promise.all(STYLES.map(async (each) => (await fetch(`/web/css/${each}.css`)).text()));
  return { copy, css: `${styles.join("\n")}\n${CHARTS}` };
}

// A button that carries content, as the content alone.
function replica(control, twin) {
  const made = document.createElement("div");
  made.className = control.className;
  made.append(...twin.childNodes);
  const heat = control.style.getPropertyValue("--heat");
  if (heat) made.style.setProperty("--heat", heat);
  return made;
}

const theme = () => document.documentElement.dataset.theme;

export async function saveReport(place, name) {
  const { copy, css } = await frozen(place);
  const head =
    '<meta charset="utf-8"><meta name="viewport" content="width=device-width">' +
    `${element("title", document.title).outerHTML}<style>${css}\n${WHOLE}</style>`;
  download(
    `${name}.html`,
    `<!doctype html>\n<html lang="en" data-theme="${theme()}">` +
      `<head>${head}</head><body><main>${copy.innerHTML}</main></body></html>\n`,
    "text/html",
  );
}

// The view as it would be printed: the copy is laid out inside an SVG image and drawn.
export async function savePicture(place, name) {
  const { copy, css } = await frozen(place);
  const width = place.offsetWidth;
  const height = place.offsetHeight + 60;
  const main = document.createElement("main");
  main.append(...copy.childNodes);
  const style = `${css}\n.scroll, .regions, .picker, .choices { overflow: hidden; }`
    .replaceAll("&", "&amp;")
    .replaceAll("<", "&lt;");
  const inside =
    `<html xmlns="http://www.w3.org/1999/xhtml" data-theme="${theme()}"><head><style>${style}</style></head>` +
    `<body>${new XMLSerializer().serializeToString(main)}</body></html>`;
  const size = getComputedStyle(document.documentElement).fontSize;
  const drawing =
    `<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${height}" style="font-size: ${size}">` +
    `<foreignObject width="100%" height="100%">${inside}</foreignObject></svg>`;
  const image = new Image();
  image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(drawing)}`;
  await image.decode();
  const canvas = document.createElement("canvas");
  canvas.width = width * SCALE;
  canvas.height = height * SCALE;
  const pen = canvas.getContext("2d");
  pen.fillStyle = getComputedStyle(document.documentElement).backgroundColor;
  pen.fillRect(0, 0, canvas.width, canvas.height);
  pen.scale(SCALE, SCALE);
  pen.drawImage(image, 0, 0);
  download(`${name}.png`, await new Promise((resolve) => canvas.toBlob(resolve, "image/png")), "image/png");
}

export function download(name, content, type) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([content], { type }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}
