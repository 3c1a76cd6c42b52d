// The values as a table: what the cursors read, least, average, greatest; and what happened meanwhile as a list.
import { summary, valueAt } from "./trends-data.js";
import { isBit, look } from "./trends-plot.js";
import { length, formatTime } from "./trends-time.js";

const words = () => document.getElementById("trend-words").dataset;
const UNKNOWN = "–";
const MAX_DIGITS = 3;
/** @type {Map<number | null, Intl.NumberFormat>} */
const formats = new Map();

/** @param {number} value @param {number | null} decimals */
function number(value, decimals) {
  const [minimumFractionDigits, maximumFractionDigits] = [decimals ?? 0, decimals ?? MAX_DIGITS];
  const shape = { minimumFractionDigits, maximumFractionDigits, useGrouping: false };
  const found = formats.get(decimals) ?? new Intl.NumberFormat(words().language, shape);
  formats.set(decimals, found);
  return found.format(value);
}

/** @param {Result} result @param {number | null} [value] */
function text(result, value) {
  if (value === null || value === undefined) return UNKNOWN;
  if (isBit(result) && (value === 0 || value === 1)) return value ? words().on : words().off;
  return number(value, isBit(result) ? 2 : result.decimals);
}

/** @param {number} place */
function swatch(place) {
  const { name, dash } = look(place);
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
  svg.setAttribute("class", "trends__swatch");
  svg.setAttribute("viewBox", "0 0 32 8");
  svg.setAttribute("aria-hidden", "true");
  path.setAttribute("d", "M0 4h32");
  path.style.stroke = `var(${name})`;
  if (dash.length) path.setAttribute("stroke-dasharray", dash.join(" "));
  svg.append(path);
  return svg;
}

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
 * @param {HTMLTableSectionElement} body @param {Result[]} results @param {string[]} names @param {RowActions} on */
export function drawRows(body, results, names, on) {
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
      axis.dataset.key = `axis ${names[place]}`;
      axis.append(swatch(place), result.name + (result.measure ? ` [${result.measure}]` : ""));
      axis.addEventListener("click", () => on.choose(place));
      head.append(axis);
      row.append(head);
      const found = summary(result);
      const read = [null, null, null, null, found?.least, found?.average, found?.greatest];
      read.forEach((value, i) => {
        cell(row, text(result, value), heads[i + 1].textContent);
      });
      const remove = document.createElement("button");
      remove.type = "button";
      remove.className = "button button--small";
      remove.textContent = "×";
      remove.dataset.key = names[place];
      remove.setAttribute("aria-label", `${words().remove}: ${result.name}`);
      remove.addEventListener("click", () => on.remove(names[place]));
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

/** What the cursor and A and B read; B − A where both are set.
 * @param {HTMLTableSectionElement} body @param {Result[]} results @param {Cursors} cursors */
export function drawCursors(body, results, { at, a, b }) {
  [...body.rows].forEach((row, place) => {
    const result = results[place];
    if (!result) return;
    /** @param {number | null} time */
    const read = (time) => (time === null ? null : valueAt(result, time));
    const [va, vb] = [read(a), read(b)];
    row.cells[1].textContent = text(result, read(at));
    row.cells[2].textContent = text(result, va);
    row.cells[3].textContent = text(result, vb);
    row.cells[4].textContent =
      va === null || vb === null || isBit(result) ? UNKNOWN : number(vb - va, result.decimals);
  });
  /** @param {number | null} time */
  const moment = (time) => (time === null ? UNKNOWN : formatTime(time));
  document.getElementById("time-cursor").textContent = moment(at);
  document.getElementById("time-a").textContent = moment(a);
  document.getElementById("time-b").textContent = moment(b);
  document.getElementById("time-difference").textContent = a === null || b === null ? UNKNOWN : length(Math.abs(b - a));
}

/** The chart as text.
 * @param {Result[]} results */
export function summaryText(results) {
  const lines = results.map((result) => {
    const found = summary(result);
    if (!found) return `${result.name}: ${words().nothing}`;
    const holes = found.holes ? `, ${words().holes.replace("{n}", String(found.holes))}` : "";
    return `${result.name}: ${text(result, found.least)} … ${text(result, found.greatest)}${holes}`;
  });
  return lines.join("; ");
}

/** What every value reads at a moment.
 * @param {Result[]} results @param {number} at */
export const valuesText = (results, at) =>
  [formatTime(at), ...results.map((result) => `${result.name} ${text(result, valueAt(result, at))}`)].join("; ");

/** How fine the picture is.
 * @param {Result[]} results */
export const fineness = (results) => {
  const bucket = Math.max(0, ...results.map((result) => result.bucket_s));
  return bucket ? words().per.replace("{n}", length(bucket)) : words().every;
};

/** What happened at times `t`, as a list with its count: a press puts the cursor there. `content` gives the nodes
 * of an item.
 * @template {Mark | Alarm} T @param {HTMLElement} list @param {HTMLElement} count @param {{ items: T[], more: boolean }} found
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

/** An event in a list.
 * @param {Mark} mark */
export function eventContent(mark) {
  const where = mark.unit ? `${mark.bus}/${mark.unit} · ` : mark.bus ? `${mark.bus} · ` : "";
  const { what, old, new: changed } = mark.shown;
  const change = old || changed ? `: ${old || UNKNOWN} → ${changed || UNKNOWN}` : "";
  return [`${formatTime(mark.t)} · ${where}${what}${change}${mark.who ? ` (${mark.who})` : ""}`];
}
