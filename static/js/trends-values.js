// A value as text, in the language of the page.
import { isBit } from "./trends-look.js";

const words = () => document.getElementById("trend-words").dataset;
export const UNKNOWN = "–";
const MAX_DIGITS = 3;
/** @type {Map<number | null, Intl.NumberFormat>} */
const formats = new Map();

/** @param {number} value @param {number | null} decimals */
export function number(value, decimals) {
  const [minimumFractionDigits, maximumFractionDigits] = [decimals ?? 0, decimals ?? MAX_DIGITS];
  const shape = { minimumFractionDigits, maximumFractionDigits, useGrouping: false };
  const found = formats.get(decimals) ?? new Intl.NumberFormat(words().language, shape);
  formats.set(decimals, found);
  return found.format(value);
}

/** @param {Result} result @param {number | null} [value] */
export function shownValue(result, value) {
  if (value === null || value === undefined) return UNKNOWN;
  if (isBit(result) && (value === 0 || value === 1)) return value ? words().on : words().off;
  return number(value, isBit(result) ? 2 : result.decimals);
}
