// Numbers with units and SI prefixes, times in the viewer's zone, decimal point as the browser's language has it.

const four = new Intl.NumberFormat(undefined, { maximumSignificantDigits: 4 });
const whole = new Intl.NumberFormat(undefined, { maximumFractionDigits: 0 });
const clock = new Intl.DateTimeFormat(undefined, { hour: "2-digit", minute: "2-digit", second: "2-digit" });
const date = new Intl.DateTimeFormat(undefined, { dateStyle: "medium", timeStyle: "medium" });
const PREFIXES = { "-12": "p", "-9": "n", "-6": "µ", "-3": "m", 0: "", 3: "k", 6: "M", 9: "G" };
const PREFIXABLE = /^(V|A|W|N|Pa|Hz|s|m|J|Ω|N·m|m\/s²|m\/s\^2|m\/s|rad\/s)$/;

export function number(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-4 || size >= 1e7)) {
    const [digits, power] = value.toExponential(3).split("e");
    return `${four.format(Number(digits))} × 10${raised(Number(power))}`;
  }
  return four.format(value);
}

const raised = (power) => String(power).replaceAll(/[-0-9]/g, (sign) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(sign)]);

// `kg*m**2` as people write it: kg·m²; the unit of a pure number is not shown.
export const unitText = (unit) =>
  !unit || unit === "1"
    ? ""
    : unit
        .replaceAll(/\*\*(-?\d+)/g, (_, power) => raised(power))
        .replaceAll("*", "·")
        .replaceAll(/\bohm\b/g, "Ω")
        .replaceAll(/\b(delta_)?deg([CF])\b/g, (_, difference, scale) => (difference && scale === "C" ? "K" : `°${scale}`));
// Units within a sentence, as they are drawn elsewhere.
export const unitsIn = (text) =>
  text.replaceAll(/(?<=\d )[A-Za-z%°][\w%°/*^-]*/g, (word) => (/[*]/.test(word) ? unitText(word) : word));
export const inBrackets = (unit) => (unitText(unit) ? ` [${unitText(unit)}]` : "");

// `beside` is a number shown next to it: both then get the same prefix.
export function quantity(value, unit = "", beside = value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  unit = unitText(unit);
  if (!unit) return number(value);
  const size = Math.max(Math.abs(value), Number.isFinite(beside) ? Math.abs(beside) : 0);
  if (PREFIXABLE.test(unit) && size !== 0 && (size < 0.01 || size >= 1e4)) {
    const power = Math.floor(Math.log10(size * (1 + 1e-12)) / 3) * 3;
    if (PREFIXES[power] !== undefined) return `${four.format(value / 10 ** power)}\u00a0${PREFIXES[power]}${unit}`;
  }
  return `${number(value)}\u00a0${unit}`;
}

// Decimals of a sentence that the service wrote, as the browser's language has them.
export const localised = (text) =>
  text.replaceAll(/(?<![\w.])-?(?:\d+\.\d+(?:e[+-]?\d+)?|\d+e[+-]?\d+)(?!\.?\w)/g, (figure) => number(Number(figure)));

// A share as percent, with its unit on the same line.
export function percent(share) {
  if (share > 0 && share < 5e-4) return `<\u00a0${number(0.1)}\u00a0%`;
  return `${number(Math.round(1000 * share) / 10)}\u00a0%`;
}

export const count = (value) => (Number.isFinite(value) ? whole.format(value) : "–");
export const time = (text) => (text ? clock.format(new Date(text)) : "–");
export const moment = (text) => (text ? date.format(new Date(text)) : "–");

export function ago(text) {
  if (!text) return "never";
  return `${span(Math.max(0, (Date.now() - new Date(text)) / 1000))} ago`;
}

export function span(seconds) {
  if (!Number.isFinite(seconds)) return "–";
  if (seconds < 60) return `${Math.round(seconds)} s`;
  if (seconds < 3600) return `${Math.round(seconds / 60)} min`;
  return seconds < 172800 ? `${Math.round(seconds / 3600)} h` : `${Math.round(seconds / 86400)} d`;
}

export const title = (name) => name.replaceAll(/[-_]/g, " ");
export const assetTitle = (asset) => (asset.title && asset.title !== asset.id ? asset.title : capital(title(asset.id)));
export const capital = (text) => text.charAt(0).toUpperCase() + text.slice(1);
