// Texts that only the browser needs, in the page's language: they stand in <template id="words" data-…>.
/** @type {Record<string, string | undefined>} */
const table = document.getElementById("words")?.dataset ?? {};
export const language = document.documentElement.lang || "en";

/** The text called `name`; {n} becomes `value`.
 * @param {string} name @param {string | number} [value] */
export const word = (name, value = "") => (table[name] ?? name).replace("{n}", String(value));

const oneDigit = new Intl.NumberFormat(language, { minimumFractionDigits: 1, maximumFractionDigits: 1 });

/** A span of time as text: 0.3 s, 12 s, 4 min, 3 h.
 * @param {number} seconds */
export function span(seconds) {
  if (seconds < 9.95) return word("seconds", oneDigit.format(Math.max(0, seconds)));
  if (seconds < 120) return word("seconds", Math.floor(seconds));
  if (seconds < 7200) return word("minutes", Math.floor(seconds / 60));
  return word("hours", Math.floor(seconds / 3600));
}
