// The last ten minutes of one unit on its page: commanded as a fine step, actual as a line, one scale for both.
// Gaps stay gaps. Requested every five seconds; the current values are in the numbers above.
import { value } from "./bind.js";
import { now } from "./clock.js";
import { isLive } from "./live.js";
import { language, word } from "./words.js";

const SPAN_S = 600;
const EVERY_MS = 5000;
const [WIDTH, HEIGHT] = [600, 100];
const SVG = "http://www.w3.org/2000/svg";

/** @param {string} className */
export function path(className) {
  const line = document.createElementNS(SVG, "path");
  line.setAttribute("class", className);
  return line;
}

/** @param {HTMLElement} figure */
export function build(figure) {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", `0 0 ${WIDTH} ${HEIGHT}`);
  svg.setAttribute("preserveAspectRatio", "none");
  svg.setAttribute("aria-hidden", "true");
  const lines = { commanded: path("minutes__commanded"), actual: path("minutes__actual") };
  svg.append(lines.commanded, lines.actual);
  const labels = ["most", "least", "from", "now"].map((name) => {
    const label = document.createElement("span");
    label.className = `minutes__${name}`;
    return label;
  });
  labels[2].textContent = `−${word("minutes", 10)}`;
  labels[3].textContent = word("now");
  figure.append(svg, ...labels);
  return { lines, labels };
}

/** The range to draw: never so narrow that noise looks like movement.
 * @param {(number | null)[]} all */
export function range(all) {
  const known = all.filter((value) => value !== null);
  if (!known.length) return null;
  const [least, most] = [Math.min(...known), Math.max(...known)];
  const pad = Math.max((most - least) * 0.1, Math.abs(most) * 0.01, 0.1);
  return { least: Math.max(0, least - pad), most: most + pad };
}

/** @param {Spark} spark @param {number} from @param {Scale} scale @param {boolean} step */
export function outline({ t, avg }, from, { least, most }, step) {
  let d = "";
  let pen = false;
  let y = "";
  for (let i = 0; i < t.length; i += 1) {
    const drawn = avg[i];
    if (drawn === null) {
      pen = false;
      continue;
    }
    const x = (((t[i] - from) / SPAN_S) * WIDTH).toFixed(1);
    const next = (HEIGHT - ((drawn - least) / (most - least)) * HEIGHT).toFixed(1);
    if (pen && step) d += `L${x} ${y}`;
    d += `${pen ? "L" : "M"}${x} ${next}`;
    y = next;
    pen = true;
  }
  return d;
}

/** A number with as many decimals as the unit itself shows.
 * @param {string} unit @param {number} number */
export function inUnitsDecimals(unit, number) {
  const decimals = value(`${unit}.setpoint`)?.[1] ?? 0;
  const [minimumFractionDigits, maximumFractionDigits] = [decimals, decimals];
  const shape = { minimumFractionDigits, maximumFractionDigits, useGrouping: false };
  return number.toLocaleString(language, shape);
}

/** @param {string} unit @param {ReturnType<typeof build>} parts */
async function draw(unit, { lines, labels }) {
  if (!isLive() || document.visibilityState !== "visible") return;
  const to = now();
  const query = new URLSearchParams([
    ["series", `${unit}/actual`],
    ["series", `${unit}/commanded`],
    ["from", new Date((to - SPAN_S) * 1000).toISOString()],
    ["to", new Date(to * 1000).toISOString()],
    ["format", "epoch"],
  ]);
  const response = await fetch(`/api/v1/history/sparks?${query}`, { signal: AbortSignal.timeout(4000) });
  if (!response.ok) return;
  const found = await response.json();
  const [actual, commanded] = [found[`${unit}/actual`], found[`${unit}/commanded`]];
  const scale = range([...actual.avg, ...commanded.avg]);
  if (!scale) return;
  lines.actual.setAttribute("d", outline(actual, to - SPAN_S, scale, false));
  lines.commanded.setAttribute("d", outline(commanded, to - SPAN_S, scale, true));
  labels[0].textContent = inUnitsDecimals(unit, scale.most);
  labels[1].textContent = inUnitsDecimals(unit, scale.least);
}

export function start() {
  for (const figure of document.querySelectorAll("[data-ten-minutes]")) {
    const parts = build(figure);
    const again = () => draw(figure.dataset.tenMinutes, parts).catch(() => {});
    document.addEventListener("lineside:found", again);
    setInterval(again, EVERY_MS);
  }
}
