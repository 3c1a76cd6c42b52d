// Times at the site: its zone, not the browser's.
import { zone } from "./clock.js";

/** With its region, so that a date is written as the server writes it. */
export const language = document.getElementById("trends")?.dataset.locale || document.documentElement.lang || "en";
/** @type {Record<string, Intl.DateTimeFormatOptions>} */
const PARTS = {
  clock: { hour: "2-digit", minute: "2-digit" },
  second: { hour: "2-digit", minute: "2-digit", second: "2-digit" },
  exact: { hour: "2-digit", minute: "2-digit", second: "2-digit", fractionalSecondDigits: 3 },
  date: { dateStyle: "short" },
  day: { day: "numeric", month: "short" },
  dayClock: { day: "numeric", month: "short", hour: "2-digit", minute: "2-digit" },
  minute: { dateStyle: "medium", timeStyle: "short" },
  month: { month: "short", year: "numeric" },
  moment: { dateStyle: "medium", timeStyle: "medium" },
};
/** @type {Map<string, Intl.DateTimeFormat>} */
const formats = new Map();

/** Each is made when it is first wanted: one costs a millisecond.
 * @param {string} kind @returns {Intl.DateTimeFormat} */
function format(kind) {
  const found =
    formats.get(kind) ?? new Intl.DateTimeFormat(language, { timeZone: zone, hourCycle: "h23", ...PARTS[kind] });
  formats.set(kind, found);
  return found;
}

/** Seconds since the epoch as text; `kind` is a key of PARTS.
 * @param {number} seconds */
export const formatTime = (seconds, kind = "moment") => format(kind).format(seconds * 1000);
