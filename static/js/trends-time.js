// Counting with the wall clock of the site, and the texts of times, lengths and numbers.
import { zone } from "./clock.js";
import { formatTime, language } from "./site-time.js";

/** Swedish dates are those of ISO 8601. */
const WALL = new Intl.DateTimeFormat("sv", { timeZone: zone, dateStyle: "short", timeStyle: "medium" });
const MAX_DIGITS = 3;
export const DAY = 86400;

/** The wall clock at the site, as if it were UTC: seconds that can be counted with. @param {number} seconds */
const wall = (seconds) => Date.parse(`${WALL.format(seconds * 1000).replace(" ", "T")}Z`) / 1000;

/** The instant at which the wall clock at the site shows this; near a change of summer time, one of the two.
 * @param {number} wallSeconds */
function instant(wallSeconds) {
  const guess = wallSeconds - (wall(wallSeconds) - wallSeconds);
  return guess - (wall(guess) - wallSeconds);
}

/** The same time of day on the day before. @param {number} at */
export const dayBefore = (at) => instant(wall(at) - DAY);

/** When the day of a moment began at the site. @param {number} at */
export function dayStart(at) {
  const clock = wall(at);
  return instant(clock - (clock % DAY));
}

/** The shift that a moment is in. `starts`: minutes after midnight at the site.
 * @param {number} at @param {number[]} starts @returns {Span} */
export function shiftAt(at, starts) {
  const clock = wall(at);
  const midnight = clock - (clock % DAY);
  const edges = [-1, 0, 1, 2]
    .flatMap((days) => starts.map((minute) => instant(midnight + days * DAY + minute * 60)))
    .sort((a, b) => a - b);
  const next = edges.findIndex((edge) => edge > at);
  return [edges[next - 1], edges[next]];
}

/** The time of day; with its day where that is another than of `beside`. @param {number} at @param {number} beside */
export const shortTime = (at, beside) =>
  formatTime(at, formatTime(at, "day") === formatTime(beside, "day") ? "clock" : "dayClock");

const TYPED = /^(?:(\d{4})-(\d\d?)-(\d\d?)|(\d\d?)\. ?(\d\d?)\. ?(\d{4}))[T,]? *(\d\d?):(\d\d)(?::(\d\d))?$/;

/** As a field takes it: 21.11.2026 06:00:00 where dates have dots, else ISO 8601, in which day and month are not mistaken.
 * @param {number} seconds */
export function toField(seconds) {
  const [day, clock] = WALL.format(seconds * 1000).split(" ");
  const hasDots = formatTime(seconds, "date").includes(".");
  return `${hasDots ? day.split("-").reverse().join(".") : day} ${clock}`;
}

/** The instant that was typed in a field; NaN if it is none. @param {string} text */
export function fromField(text) {
  const typed = TYPED.exec(text.trim())?.map(Number);
  if (!typed) return Number.NaN;
  const [, y, m, d, day, month, year, hour, minute, second] = typed;
  return instant(Date.UTC(y || year, (m || month) - 1, d || day, hour, minute, second || 0) / 1000);
}

/** Labels under the time axis, no finer than the distance between them.
 * @param {uPlot} _plot @param {number[]} splits @param {number} _axis @param {number} _space @param {number} increment */
export function axisLabels(_plot, splits, _axis, _space, increment) {
  let before = "";
  return splits.map((at) => {
    if (increment >= 28 * DAY) return formatTime(at, "month");
    if (increment >= DAY) return formatTime(at, "day");
    const text = formatTime(at, increment >= 60 ? "clock" : increment >= 1 ? "second" : "exact");
    const day = formatTime(at, "day");
    const label = day === before ? text : `${text}\n${day}`;
    before = day;
    return label;
  });
}

/** @type {Map<number | null, Intl.NumberFormat>} */
const formats = new Map();

/** A number in the language of the page, not of the browser; `decimals` null: as many as it has, up to three.
 * @param {number} value @param {number | null} decimals */
export function number(value, decimals) {
  const [minimumFractionDigits, maximumFractionDigits] = [decimals ?? 0, decimals ?? MAX_DIGITS];
  const shape = { minimumFractionDigits, maximumFractionDigits, useGrouping: false };
  const format = formats.get(decimals) ?? new Intl.NumberFormat(language, shape);
  formats.set(decimals, format);
  return format.format(value);
}

/** The numbers at an axis, each with the digits of its step.
 * @param {uPlot} _plot @param {number[]} splits @param {number} _axis @param {number} _space @param {number} step */
export const axisNumbers = (_plot, splits, _axis, _space, step) =>
  splits.map((split) => number(split, (String(step).split(".")[1] ?? "").length));

/** 0.2 s, 30 s, 5 min, 8 h, 3 d. @param {number} seconds */
export function length(seconds) {
  if (seconds < 10) return `${number(seconds, null)} s`;
  const [unit, name] = seconds < 120 ? [1, "s"] : seconds < 7200 ? [60, "min"] : seconds < 2 * DAY ? [3600, "h"] : [DAY, "d"];
  return `${number(Math.round((10 * seconds) / Number(unit)) / 10, null)} ${name}`;
}
