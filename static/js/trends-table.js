// The values as a table: what A and B read, least, average, greatest; and what happened meanwhile as a list.
import { formatTime } from "./site-time.js";
import { summary, valueAt } from "./trends-data.js";
import { isBit, swatch } from "./trends-look.js";
import { length } from "./trends-time.js";
import { number, shownValue, UNKNOWN } from "./trends-values.js";

const words = () => document.getElementById("trend-words").dataset;

/** With the head of its column, which a phone shows beside it.
 * @param {HTMLTableRowElement} row @param {string} content */
function cell(row, content, head = "") {
  const td = row.insertCell();
  td.className = "number";
  if (head) td.dataset.head = head;
  td.textContent = content;
  return td;
}

/** One row for each value; `on`: remove(name), choose(place).
 * @param {HTMLTableSectionElement} body @param {Curve[]} results @param {RowActions} on */
export function drawRows(body, results, on) {
  const { tHead } = /** @type {HTMLTableElement} */ (body.parentElement);
  const heads = /** @type {HTMLTableSectionElement} */ (tHead).rows[0].cells;
  const focused = body.contains(document.activeElement) ? /** @type {HTMLElement} */ (document.activeElement) : null;
  const place = focused?.closest("tr")?.sectionRowIndex ?? 0;
  body.replaceChildren(
    ...results.map((result, place) => {
      const row = document.createElement("tr");
      const head = document.createElement("th");
      head.scope = "row";
      const axis = document.createElement("button");
      axis.type = "button";
      axis.className = "trends__axis";
      axis.dataset.key = `axis ${result.key}`;
      axis.append(swatch(place, result.value), result.name + (result.measure ? ` [${result.measure}]` : ""));
      axis.addEventListener("click", () => on.choose(place));
      head.append(axis);
      row.append(head);
      const found = summary(result);
      const read = [null, null, null, found?.least, found?.average, found?.greatest];
      read.forEach((value, i) => {
        cell(row, shownValue(result, value), heads[i + 1].textContent);
      });
      const remove = document.createElement("button");
      remove.type = "button";
      remove.className = "button button--small";
      remove.textContent = "×";
      remove.dataset.key = result.key;
      remove.setAttribute("aria-label", `${words().remove}: ${result.name}`);
      remove.addEventListener("click", () => on.remove(result.key));
      cell(row, "").append(remove);
      return row;
    }),
  );
  if (focused) twinOf(focused, body, place).focus();
}

/** Where the focus goes when rows are redrawn: to the same button, else (its value was taken away) to the one
 * that came in its place, at last to where a value is added.
 * @param {HTMLElement} button @param {HTMLTableSectionElement} body @param {number} place */
function twinOf(button, body, place) {
  const same = [...body.querySelectorAll("button")].find(({ dataset }) => dataset.key === button.dataset.key);
  const next = body.rows[Math.min(place, body.rows.length - 1)]?.querySelector("button[aria-label]");
  return same ?? next ?? document.getElementById("trend-add").elements.unit;
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
  const focused = list.contains(document.activeElement) ? document.activeElement?.textContent : null;
  count.textContent = items.length + (more ? ` – ${words().more}` : "");
  list.replaceChildren(
    ...items.map((item) => {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...content(item));
      button.addEventListener("click", () => put(item.t));
      const line = document.createElement("li");
      line.append(button);
      return line;
    }),
  );
  if (focused) [...list.querySelectorAll("button")].find(({ textContent }) => textContent === focused)?.focus();
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
  const mark = document.createElement("span");
  mark.className = "alarm-priority alarm-priority--word";
  mark.dataset.is = priority;
  const shape = document.createElement("i");
  shape.className = "alarm-priority__shape";
  shape.ariaHidden = "true";
  mark.append(shape, words[priority] ?? "");
  const end = until === null ? words.active : formatTime(until);
  return [mark, `${formatTime(t)} – ${end} · ${place && `${place} · `}${name}`];
}
