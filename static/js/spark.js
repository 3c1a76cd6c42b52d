// The curve of ten minutes, as an SVG path: of a unit's page, of its tile, of an alarm. A gap stays a gap.
import { now } from "./clock.js";

export const SPAN_S = 600;
export const [WIDTH, HEIGHT] = [600, 100];
const SVG = "http://www.w3.org/2000/svg";

/** A drawing that is stretched to its place.
 * @param {...SVGPathElement} lines */
export function drawing(...lines) {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", `0 0 ${WIDTH} ${HEIGHT}`);
  svg.setAttribute("preserveAspectRatio", "none");
  svg.setAttribute("aria-hidden", "true");
  svg.append(...lines);
  return svg;
}

/** @param {string} className */
export function path(className) {
  const line = document.createElementNS(SVG, "path");
  line.setAttribute("class", className);
  return line;
}

/** Actual and commanded speed of units over the last ten minutes: by `unit/value`, and when they begin.
 * @param {string[]} units @returns {Promise<{ from: number, found: Record<string, Spark> }>} */
export async function fetchMinutes(units) {
  const to = now();
  const query = new URLSearchParams({
    from: new Date((to - SPAN_S) * 1000).toISOString(),
    to: new Date(to * 1000).toISOString(),
    format: "epoch",
  });
  for (const unit of units) for (const value of ["actual", "commanded"]) query.append("series", `${unit}/${value}`);
  const response = await fetch(`/api/v1/history/sparks?${query}`, { signal: AbortSignal.timeout(4000) });
  if (!response.ok) throw new Error(String(response.status));
  return { from: to - SPAN_S, found: await response.json() };
}

/** The range to draw: never so narrow that noise looks like movement, and with an at-speed window on both sides.
 * @param {(number | null)[]} all @param {number} window */
export function range(all, window = 0) {
  const known = all.filter((value) => value !== null);
  if (!known.length) return null;
  const [least, most] = [Math.min(...known), Math.max(...known)];
  const pad = Math.max((most - least) * 0.1, Math.abs(most) * 0.01, 0.1, 1.5 * window);
  return { least: Math.max(0, least - pad), most: most + pad };
}

/** The part of the height between two numbers that does not let them touch. */
const APART = 0.2;

/** The greatest and the least value that is drawn, each with where that is, as a part of the height from the top; the least only
 * where it does not touch the greatest. @param {(number | null)[]} all @param {Scale} scale */
export function extremes(all, { least, most }) {
  const known = all.filter((value) => value !== null);
  const [first, last] = [Math.max(...known), Math.min(...known)].map((value) => ({ value, at: (most - value) / (most - least) }));
  return last.at - first.at < APART ? [first] : [first, last];
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
    if (pen && avg[i - 1] === drawn && avg[i + 1] === drawn) continue;
    const x = (((t[i] - from) / SPAN_S) * WIDTH).toFixed(1);
    const next = (HEIGHT - ((drawn - least) / (most - least)) * HEIGHT).toFixed(1);
    if (pen && step) d += `L${x} ${y}`;
    d += `${pen ? "L" : "M"}${x} ${next}`;
    y = next;
    pen = true;
  }
  return d;
}

/** The at-speed band around a setpoint, as far as it is known.
 * @param {Spark} commanded @param {number} from @param {Scale} scale @param {number} window */
export function band({ t, avg }, from, { least, most }, window) {
  const y = (/** @type {number} */ at) => (HEIGHT - ((at - least) / (most - least)) * HEIGHT).toFixed(1);
  let d = "";
  for (let i = 0; i < t.length; i += 1) {
    const [middle, begun] = [avg[i], t[i]];
    if (middle === null) continue;
    while (avg[i + 1] === middle) i += 1;
    const [x, next] = [begun, avg[i + 1] == null ? t[i] : t[i + 1]].map((at) => (((at - from) / SPAN_S) * WIDTH).toFixed(1));
    d += `M${x} ${y(middle + window)}H${next}V${y(middle - window)}H${x}Z`;
  }
  return d;
}
