// <trend-spark data-spark="dry-end/1"> draws ten minutes of its unit's actual speed; data-value="commanded" another.
// All visible ones on a page are requested together, every ten seconds.
import { now } from "./clock.js";

const MINUTES = 10;
const EVERY_MS = 10_000;
const [WIDTH, HEIGHT] = [240, 40];
/** The height of the drawing, as a part of the value, at least. */
const MIN_REACH = 0.02;
const SVG = "http://www.w3.org/2000/svg";
/** @type {Set<TrendSpark>} */
const visible = new Set();
let requested = false;

class TrendSpark extends HTMLElement {
  connectedCallback() {
    this.path = document.createElementNS(SVG, "path");
    const svg = document.createElementNS(SVG, "svg");
    svg.setAttribute("viewBox", `0 0 ${WIDTH} ${HEIGHT}`);
    svg.setAttribute("preserveAspectRatio", "none");
    svg.setAttribute("aria-hidden", "true");
    svg.append(this.path);
    this.replaceChildren(svg);
    observer.observe(this);
  }

  disconnectedCallback() {
    observer.unobserve(this);
    visible.delete(this);
  }

  get series() {
    return `${this.dataset.spark}/${this.dataset.value ?? "actual"}`;
  }

  /** @param {Spark} spark @param {number} from @param {number} to */
  draw({ t, avg }, from, to) {
    this.path?.setAttribute("d", outline(t, avg, from, to));
  }
}

/** An SVG path over the span; a null lifts the pen. Never so high that noise looks like movement.
 * @param {number[]} t @param {(number | null)[]} values @param {number} from @param {number} to */
function outline(t, values, from, to) {
  const known = values.filter((value) => value !== null);
  const [least, greatest] = [Math.min(...known), Math.max(...known)];
  const middle = (least + greatest) / 2;
  const reach = Math.max(greatest - least, Math.abs(middle) * MIN_REACH) || 1;
  let pen = "M";
  let path = "";
  for (let i = 0; i < t.length; i++) {
    const value = values[i];
    if (value === null) {
      pen = "M";
      continue;
    }
    const x = ((t[i] - from) / (to - from)) * WIDTH;
    const y = HEIGHT / 2 - ((value - middle) / reach) * (HEIGHT - 4);
    path += `${pen}${x.toFixed(1)} ${y.toFixed(1)}`;
    pen = "L";
  }
  return path;
}

const observer = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries)
    visible[isIntersecting ? "add" : "delete"](/** @type {TrendSpark} */ (target));
  if (!requested) refresh();
});

/** Null without a complete response: the lines keep their state.
 * @param {URLSearchParams} query @returns {Promise<Record<string, Spark> | null>} */
async function fetchSparks(query) {
  try {
    const response = await fetch(`/api/v1/history/sparks?${query}`);
    return response.ok ? await response.json() : null;
  } catch {
    return null;
  }
}

async function refresh() {
  if (document.hidden || !visible.size) return;
  requested = true;
  const to = now();
  const from = to - MINUTES * 60;
  const query = new URLSearchParams({
    from: new Date(from * 1000).toISOString(),
    to: new Date(to * 1000).toISOString(),
    format: "epoch",
  });
  for (const name of new Set([...visible].map((spark) => spark.series))) query.append("series", name);
  const found = await fetchSparks(query);
  if (!found) return;
  for (const spark of visible) if (found[spark.series]) spark.draw(found[spark.series], from, to);
}

customElements.define("trend-spark", TrendSpark);
setInterval(refresh, EVERY_MS);
