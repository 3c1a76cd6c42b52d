// The values as a table: what A and B read, least, average, greatest; and what happened meanwhile as a list.
import { element, refill } from "./element.js";
import { formatTime } from "./site-time.js";
import { summary, valueAt } from "./trends-data.js";
import { isBit, swatch } from "./trends-look.js";
import { length } from "./trends-time.js";
import { number, shownValue, UNKNOWN } from "./trends-values.js";

const words = () => document.getElementById("trend-words").dataset;

/** One row for each value; `on`: remove(name), choose(place).
 * @param {HTMLTableSectionElement} body @param {Curve[]} results @param {RowActions} on */
export function drawRows(body, results, on) {
  const { tHead } = /** @type {HTMLTableElement} */ (body.parentElement);
  const heads = [.../** @type {HTMLTableSectionElement} */ (tHead).rows[0].cells].map(({ textContent }) => textContent ?? "");
  const place = document.activeElement?.closest("tr")?.sectionRowIndex ?? 0;
  const rows = results.map((result, place) => {
    const { key, name, measure, value } = result;
    const title = name + (measure ? ` [${measure}]` : "");
    const axis = element("button", { type: "button", className: "trends__axis" }, { key: `axis ${key}` }, swatch(place, value), title);
    axis.addEventListener("click", () => on.choose(place));
    const remove = element("button", { type: "button", className: "button button--small", ariaLabel: `${words().remove}: ${name}` }, { key }, "×");
    remove.addEventListener("click", () => on.remove(key));
    const found = summary(result);
    const read = [null, null, null, found?.least, found?.average, found?.greatest];
    // With the head of its column, which a phone shows beside it.
    const cells = read.map((each, i) => element("td", { className: "number" }, { head: heads[i + 1] }, shownValue(result, each)));
    return element("tr", {}, {}, element("th", { scope: "row" }, {}, axis), ...cells, element("td", { className: "number" }, {}, remove));
  });
  // The focus of a value that was taken away goes to the one that came in its place, at last to where a value is added.
  refill(body, rows, () => {
    const next = body.rows[Math.min(place, body.rows.length - 1)]?.querySelector("button[aria-label]");
    return /** @type {HTMLElement | null} */ (next) ?? document.getElementById("trend-add").elements.unit;
  });
}

/** What A and B read; B − A where both are set.
 * @param {HTMLTableSectionElement} body @param {Result[]} results @param {Cursors} cursors */
export function drawCursors(body, results, { a, b }) {
  [...body.rows].forEach((row, place) => {
    const result = results[place];
    if (!result) return;
    /** @param {number | null} time */
    const read = (time) => (time === null ? null : valueAt(result, time));
    const [va, vb] = [read(a), read(b)];
    row.cells[1].textContent = shownValue(result, va);
    row.cells[2].textContent = shownValue(result, vb);
    row.cells[3].textContent =
      va === null || vb === null || isBit(result) ? UNKNOWN : number(vb - va, result.decimals);
  });
  /** @param {number | null} time */
  const moment = (time) => (time === null ? UNKNOWN : formatTime(time));
  document.getElementById("time-a").textContent = moment(a);
  document.getElementById("time-b").textContent = moment(b);
  document.getElementById("time-difference").textContent = a === null || b === null ? UNKNOWN : length(Math.abs(b - a));
}

/** The chart as text.
 * @param {Curve[]} results */
export function summaryText(results) {
  const lines = results.map((result) => {
    const found = summary(result);
    if (!found) return `${result.name}: ${words().nothing}`;
    const gaps = found.holes === 1 ? words().hole : words().holes.replace("{n}", String(found.holes));
    const holes = found.holes ? `, ${gaps}` : "";
    return `${result.name}: ${shownValue(result, found.least)} … ${shownValue(result, found.greatest)}${holes}`;
  });
  return lines.join("; ");
}

/** What every value reads at a moment.
 * @param {Curve[]} results @param {number} at */
export const valuesText = (results, at) =>
  [formatTime(at), ...results.map((result) => `${result.name} ${shownValue(result, valueAt(result, at))}`)].join("; ");

/** How fine the picture is.
 * @param {Result[]} results */
export const fineness = (results) => {
  const bucket = Math.max(0, ...results.map((result) => result.bucket_s));
  return bucket ? words().per.replace("{n}", length(bucket)) : words().every;
};

/** What happened at times `t`, as a list with its count: a press puts the cursor there. `content` gives the nodes
 * of an item.
 * @template {Mark | Alarm | Note} T @param {HTMLElement} list @param {HTMLElement} count @param {{ items: T[], more: boolean }} found
 * @param {Content<T>} content @param {(seconds: number) => void} put */
export function drawList(list, count, { items, more }, content, put) {
  count.textContent = items.length + (more ? ` – ${words().more}` : "");
  const lines = items.map((item) => {
    const parts = content(item);
    const key = parts.map((part) => (typeof part === "string" ? part : part.textContent)).join("");
    const button = element("button", { type: "button" }, { key }, ...parts);
    button.addEventListener("click", () => put(item.t));
    return element("li", {}, {}, button);
  });
  refill(list, lines);
}

/** What it had listed is not known any more.
 * @param {HTMLElement} list @param {HTMLElement} count */
export function clearList(list, count) {
  count.textContent = UNKNOWN;
  list.replaceChildren();
}

/** An event in a list. @param {Mark} mark @param {(bus: string, unit: number | null) => string} place */
export function eventContent(mark, place) {
  const where = mark.bus ? `${place(mark.bus, mark.unit)} · ` : "";
  const { what, old, new: changed } = mark.shown;
  const change = old || changed ? `: ${old || UNKNOWN} → ${changed || UNKNOWN}` : "";
  const until = mark.until === null ? "" : ` – ${formatTime(mark.until)}`;
  return [`${formatTime(mark.t)}${until} · ${where}${what}${change}${mark.who ? ` (${mark.who})` : ""}`];
}

/** An alarm in a list. `words` has the priorities and `active`.
 * @param {Alarm} alarm @param {TrendWords} words */
export function alarmContent({ t, until, priority, place, name }, words) {
  const shape = element("i", { className: "alarm-priority__shape", ariaHidden: "true" });
  const mark = element("span", { className: "alarm-priority alarm-priority--word" }, { is: priority }, shape, words[priority] ?? "");
  const end = until === null ? words.active : formatTime(until);
  return [mark, `${formatTime(t)} – ${end} · ${place && `${place} · `}${name}`];
}
