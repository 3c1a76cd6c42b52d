// The values that are shown: how the line of each looks, the legend beside the chart, the table below it, and the chart as
// text; and what happened meanwhile as lists.
import { now } from "./clock.js";
import { element, refill } from "./element.js";
import { formatTime } from "./site-time.js";
import { endValue, summary, valueAt } from "./trends-data.js";
import { length, number } from "./trends-time.js";

const HUES = 8;
/** Pixels drawn and left out in turn. Only the first is solid. @type {number[][]} */
const DASHES = [[], [12, 4], [5, 3], [14, 4, 3, 4], [24, 5], [14, 4, 3, 4, 3, 4], [6, 3, 6, 9], [3, 3, 3, 3, 3, 9]];
/** In the place of the solid one, because what is commanded is always dashed. */
const COMMANDED = [9, 9];
const NUMBERS = ["commanded", "actual", "analog", "draw"];
const UNKNOWN = "–";
const LISTS = /** @type {const} */ (["events", "alarms", "notes"]);

/** Whether it is shown as a lane and not as a curve. @param {{ value: string }} result */
export const isBit = (result) => !NUMBERS.includes(result.value);

/** Custom property with the hue, and the dash of a value at a place, so that eight lines differ for every eye and 32 in one
 * of the two. @param {number} place @param {string} [value] */
export function look(place, value = "") {
  const shift = (Math.floor(place / HUES) % 4) * 3;
  const dash = DASHES[(place + shift) % DASHES.length];
  return { name: `--curve-${(place % HUES) + 1}`, dash: dash.length || value !== "commanded" ? dash : COMMANDED };
}

/** One path as a drawing. @param {string} className @param {string} d */
export function drawing(className, d) {
  const [svg, path] = ["svg", "path"].map((tag) => document.createElementNS("http://www.w3.org/2000/svg", tag));
  svg.setAttribute("class", className);
  svg.setAttribute("aria-hidden", "true");
  path.setAttribute("d", d);
  svg.append(path);
  return svg;
}

/** A short piece of the line of a curve. @param {Curve} curve */
function swatch({ place, value }) {
  const { name, dash } = look(place, value);
  const svg = drawing("trends__swatch", "M0 4h40");
  svg.setAttribute("viewBox", "0 0 40 8");
  svg.style.stroke = `var(${name})`;
  svg.style.strokeDasharray = dash.join(" ");
  return svg;
}

/** The legend beside the chart and the table below it. Their rows are made again only where the curves are others, so that none
 * moves under a finger. A button with data-act and data-of does an act on a series. */
export class Values {
  /** @param {Trends} trends */
  constructor(trends) {
    this.trends = trends;
    /** @type {{ toggle: HTMLElement, value: HTMLElement, age: HTMLElement, before: HTMLElement, cells: HTMLElement[] }[]} */
    this.rows = [];
    this.made = "";
  }

  draw() {
    const { curves, dimmed } = this.trends;
    const names = JSON.stringify(curves.map(({ key, name }) => [key, name]));
    if (names !== this.made) this.make();
    this.made = names;
    this.rows.forEach(({ toggle, cells }, i) => {
      toggle.ariaChecked = String(!dimmed.has(curves[i].key));
      const found = summary(curves[i]);
      fill(cells.slice(3), [found?.least, found?.average, found?.greatest].map((each) => shownValue(curves[i], each)));
    });
    this.read();
  }

  make() {
    const { curves, words } = this.trends;
    const body = document.getElementById("trend-values");
    const heads = [.../** @type {HTMLTableElement} */ (body.parentElement).querySelectorAll("thead th")];
    const place = document.activeElement?.closest("tr")?.sectionRowIndex ?? 0;
    const made = curves.map((curve) => {
      const { key, name, measure } = curve;
      /** @param {string} act @param {Partial<HTMLButtonElement>} properties @param {(string | Node)[]} content */
      const button = (act, properties, ...content) =>
        element("button", { type: "button", ...properties }, { key: `${act} ${key}`, act, of: key }, ...content);
      const [value, age] = ["value__number", "age"].map((className) => element("span", { className }));
      const [before, title] = [element("small"), element("bdi", {}, {}, `${curve.unit} ${name}`)];
      const toggle = button("toggle", { role: "switch" }, swatch(curve), title, element("b", {}, {}, value, " ", age), before);
      const only = button("only", { ariaLabel: `${words.onlyThis}: ${name}` }, words.only);
      const axis = button("choose", { className: "trends__axis" }, swatch(curve), name + (measure ? ` [${measure}]` : ""));
      const remove = button("remove", { className: "button button--small", ariaLabel: `${words.remove}: ${name}` }, "×");
      // With the head of its column, which a phone shows beside it.
      const cells = heads.slice(1, -1).map(({ textContent }) => element("td", { className: "number" }, { head: textContent ?? "" }));
      const [head, end] = [element("th", { scope: "row" }, {}, axis), element("td", { className: "number" }, {}, remove)];
      return { toggle, value, age, before, cells, row: element("tr", {}, {}, head, ...cells, end), item: element("li", {}, {}, toggle, only) };
    });
    this.rows = made;
    refill(document.getElementById("trend-legend"), made.map(({ item }) => item));
    // The focus of a value that was taken away goes to the one that came in its place, at last to where a value is added.
    refill(body, made.map(({ row }) => row), () => {
      const next = body.rows[Math.min(place, made.length - 1)]?.querySelector("button[aria-label]");
      return /** @type {HTMLElement | null} */ (next) ?? document.getElementById("trend-add").elements.unit;
    });
  }

  /** What all read at the cursor, or at the end of the span, with its age where a unit is silent now; and at A and B, with B − A where both are set. */
  read() {
    const { curves, past, at, range, silent, words, view: { a, b } } = this.trends;
    /** @param {Curve} curve @param {number | null} time */
    const read = (curve, time) => (time === null ? null : valueAt(curve, time));
    this.rows.forEach(({ toggle, value, age, before, cells }, i) => {
      const curve = curves[i];
      const present = at === null ? endValue(curve, range, now()) : valueAt(curve, at);
      const earlier = past.find(({ key }) => key === curve.key);
      const [va, vb] = [read(curve, a), read(curve, b)];
      const difference = va === null || vb === null || isBit(curve) ? UNKNOWN : number(vb - va, curve.decimals);
      age.textContent = (at === null && silent.get(curve.key)) || "";
      toggle.dataset.quality = age.textContent ? "stale" : "online";
      // The age has the place of the measure.
      const measure = present !== null && curve.measure && !age.textContent ? ` ${curve.measure}` : "";
      value.textContent = shownValue(curve, present) + measure;
      before.textContent = earlier ? shownValue(earlier, read(earlier, at)) : "";
      fill(cells, [shownValue(curve, va), shownValue(curve, vb), difference]);
    });
    /** @param {number | null} time */
    const moment = (time) => (time === null ? UNKNOWN : formatTime(time));
    const isLatest = at === null && this.trends.view.live;
    document.getElementById("trend-at").textContent = isLatest ? words.latest : formatTime(at ?? Math.min(range[1], now()));
    document.getElementById("time-a").textContent = moment(a);
    document.getElementById("time-b").textContent = moment(b);
    document.getElementById("time-difference").textContent = a === null || b === null ? UNKNOWN : length(Math.abs(b - a));
  }
}

/** @param {HTMLElement[]} parts @param {string[]} texts */
function fill(parts, texts) {
  for (const [i, text] of texts.entries()) parts[i].textContent = text;
}

/** A value as text, in the language of the page. @param {Result} result @param {number | null} [value] */
export function shownValue(result, value) {
  if (value === null || value === undefined) return UNKNOWN;
  if (isBit(result) && (value === 0 || value === 1)) return value ? words().on : words().off;
  return number(value, isBit(result) ? 2 : result.decimals);
}

/** The chart as text. @param {Trends} trends */
export function summaryText({ curves, words }) {
  const lines = curves.map((curve) => {
    const found = summary(curve);
    if (!found) return `${curve.name}: ${words.nothing}`;
    const gaps = found.holes === 1 ? words.hole : words.holes.replace("{n}", String(found.holes));
    const holes = found.holes ? `, ${gaps}` : "";
    return `${curve.name}: ${shownValue(curve, found.least)} … ${shownValue(curve, found.greatest)}${holes}`;
  });
  return lines.join("; ");
}

/** What every value reads at a moment. @param {Curve[]} curves @param {number} at */
export const valuesText = (curves, at) =>
  [formatTime(at), ...curves.map((curve) => `${curve.name} ${shownValue(curve, valueAt(curve, at))}`)].join("; ");

/** How fine the picture is. @param {Trends} trends */
export function fineness({ curves, words }) {
  const bucket = Math.max(0, ...curves.map(({ bucket_s }) => bucket_s));
  return bucket ? words.per.replace("{n}", length(bucket)) : words.every;
}

/** List what happened, each with its count: a press puts the cursor there.
 * @param {Trends} trends @param {(seconds: number) => void} put */
export function drawLists({ marks, alarms, notes, more, words, catalogue }, put) {
  const place = catalogue.place.bind(catalogue);
  const found = {
    events: marks.map((mark) => ({ t: mark.t, parts: eventContent(mark, place) })),
    alarms: alarms.map((alarm) => ({ t: alarm.t, parts: alarmContent(alarm, words) })),
    notes: notes.map((note, i) => ({ t: note.t, parts: noteContent(note, i, place) })),
  };
  for (const name of LISTS) {
    const [list, count] = listOf(name);
    count.textContent = found[name].length + (more.has(name) ? ` – ${words.more}` : "");
    const items = found[name].map(({ t, parts }) => {
      const key = parts.map((part) => (typeof part === "string" ? part : part.textContent)).join("");
      const button = element("button", { type: "button" }, { key }, ...parts);
      button.addEventListener("click", () => put(t));
      return element("li", {}, {}, button);
    });
    refill(list, items);
  }
}

/** What was listed is not known any more. */
export function clearLists() {
  for (const [list, count] of LISTS.map(listOf)) {
    count.textContent = UNKNOWN;
    list.replaceChildren();
  }
}

/** @param {"events" | "alarms" | "notes"} name @returns {[list: HTMLElement, count: HTMLElement]} */
export const listOf = (name) => [document.getElementById(`trend-${name}-list`), document.getElementById(`trend-${name}-count`)];

/** @param {Mark} mark @param {NamesPlace} place */
function eventContent({ t, until, bus, unit, who, shown: { what, old, new: changed } }, place) {
  const where = bus ? `${place(bus, unit)} · ` : "";
  const change = old || changed ? `: ${old || UNKNOWN} → ${changed || UNKNOWN}` : "";
  const end = until === null ? "" : ` – ${formatTime(until)}`;
  return [`${formatTime(t)}${end} · ${where}${what}${change}${who ? ` (${who})` : ""}`];
}

/** @param {Alarm} alarm @param {TrendWords} words */
function alarmContent({ t, until, priority, place, name }, words) {
  const shape = element("i", { className: "alarm-priority__shape", ariaHidden: "true" });
  const mark = element("span", { className: "alarm-priority alarm-priority--word" }, { is: until === null ? priority : `${priority} cleared` }, shape, words[priority] ?? "");
  const end = until === null ? words.active : formatTime(until);
  return [mark, `${formatTime(t)} – ${end} · ${place && `${place} · `}${name}`];
}

/** A note with the number that its flag has. @param {Note} note @param {number} i @param {NamesPlace} place */
function noteContent({ t, who, text, bus, unit }, i, place) {
  return [`${i + 1} · ${formatTime(t)}${bus ? ` · ${place(bus, unit)}` : ""} · ${text} (${who})`];
}

const words = () => document.getElementById("trend-words").dataset;
