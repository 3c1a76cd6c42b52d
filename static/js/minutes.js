// The last ten minutes of one unit on its page: commanded as a fine step, actual as a line, one scale for both, with
// flags where an alarm came and where something was set. Gaps stay gaps. Requested every five seconds, flags every
// fifteen; the current values are in the numbers above.
import { value } from "./bind.js";
import { now } from "./clock.js";
import { fetchAlarms, fetchMarks } from "./history-requests.js";
import { isLive } from "./live.js";
import { formatTime } from "./site-time.js";
import { drawing, extremes, fetchMinutes, outline, path, range, SPAN_S } from "./spark.js";
import { language, word } from "./words.js";

const EVERY_MS = 5000;
const FLAGS_EVERY_MS = 15_000;

/** @param {HTMLElement} figure */
export function build(figure) {
  const lines = { commanded: path("minutes__commanded"), actual: path("minutes__actual") };
  const svg = drawing(lines.commanded, lines.actual);
  const labels = ["most", "least", "from", "now"].map((name) => {
    const label = document.createElement("span");
    label.className = `minutes__${name}`;
    return label;
  });
  labels[2].textContent = `−${word("minutes", 10)}`;
  labels[3].textContent = word("now");
  const flags = document.createElement("div");
  flags.className = "minutes__flags";
  figure.append(svg, ...labels, flags);
  return { lines, labels, flags };
}

/** @param {number} t @param {number} from @param {string} className @param {string} words */
function flag(t, from, className, words) {
  const mark = document.createElement("i");
  mark.className = className;
  mark.title = `${formatTime(t, "second")} ${words}`;
  mark.style.setProperty("inset-inline-start", `${(100 * Math.max(0, t - from)) / SPAN_S}%`);
  return mark;
}

/** Shape and number of the priority where an alarm came, a tick where something was set.
 * @param {string} unit @param {ReturnType<typeof build>} parts */
async function drawFlags(unit, { flags }) {
  if (!isLive() || document.visibilityState !== "visible") return;
  const to = now();
  const from = to - SPAN_S;
  const names = [`${unit}/actual`];
  const [{ marks }, { alarms }] = await Promise.all([fetchMarks(names, [from, to]), fetchAlarms(names, [from, to])]);
  const set = marks
    .filter(({ who }) => who)
    .map(({ t, who, shown }) =>
      flag(t, from, "minutes__set", `${shown.what} ${[shown.old, shown.new].filter(Boolean).join(" → ")} · ${who}`),
    );
  const came = alarms
    .filter(({ t }) => t >= from)
    .map(({ t, until, name, priority }) => {
      const mark = flag(t, from, "minutes__alarm alarm-priority", name);
      mark.dataset.is = until === null ? priority : `${priority} cleared`;
      const shape = document.createElement("i");
      shape.className = "alarm-priority__shape";
      mark.append(shape);
      return mark;
    });
  flags.replaceChildren(...set, ...came);
}

/** A number with as many decimals as the unit itself shows.
 * @param {string} unit @param {number} number */
function inUnitsDecimals(unit, number) {
  const decimals = value(`${unit}.setpoint`)?.[1] ?? 0;
  const [minimumFractionDigits, maximumFractionDigits] = [decimals, decimals];
  const shape = { minimumFractionDigits, maximumFractionDigits, useGrouping: false };
  return number.toLocaleString(language, shape);
}

/** The greatest and the least value, each at its height.
 * @param {string} unit @param {HTMLElement[]} labels @param {(number | null)[]} all @param {Scale} scale */
export function nameExtremes(unit, labels, all, scale) {
  const named = extremes(all, scale);
  labels.slice(0, 2).forEach((label, i) => {
    label.textContent = named[i] ? inUnitsDecimals(unit, named[i].value) : "";
    label.style.setProperty("--at", `${named[i]?.at ?? 1}`);
  });
}

/** @param {string} unit @param {ReturnType<typeof build>} parts */
async function draw(unit, { lines, labels }) {
  if (!isLive() || document.visibilityState !== "visible") return;
  const { from, found } = await fetchMinutes([unit]);
  const [actual, commanded] = [found[`${unit}/actual`], found[`${unit}/commanded`]];
  const all = [...actual.avg, ...commanded.avg];
  const scale = range(all);
  if (!scale) return;
  lines.actual.setAttribute("d", outline(actual, from, scale, false));
  lines.commanded.setAttribute("d", outline(commanded, from, scale, true));
  nameExtremes(unit, labels, all, scale);
}

for (const figure of document.querySelectorAll("[data-ten-minutes]")) {
  const parts = build(figure);
  const unit = figure.dataset.tenMinutes;
  const again = () => draw(unit, parts).catch(() => {});
  const flagsAgain = () => drawFlags(unit, parts).catch(() => {});
  for (const [redraw, ms] of /** @type {const} */ ([[again, EVERY_MS], [flagsAgain, FLAGS_EVERY_MS]])) {
    document.addEventListener("lineside:found", redraw);
    redraw();
    setInterval(redraw, ms);
  }
}
