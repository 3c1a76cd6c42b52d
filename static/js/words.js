// Texts that only the browser needs, in the page's language: they stand in <template id="words" data-…>.
/** @type {Record<string, string | undefined>} */
const table = document.getElementById("words")?.dataset ?? {};
export const language = document.documentElement.lang || "en";

/** The text called `name`; {n} becomes `value`.
 * @param {string} name @param {string | number} [value] */
export const word = (name, value = "") => (table[name] ?? name).replace("{n}", String(value));

/** Show a text that changes again and again, in the node that is there: a new one makes the browser match what :has()
 * says of all around it.
 * @param {Element} element @param {string} text */
export function put(element, text) {
  const node = element.firstChild;
  if (!node || node !== element.lastChild) element.textContent = text;
  else if (node.nodeValue !== text) node.nodeValue = text;
}

const oneDigit = new Intl.NumberFormat(language, { minimumFractionDigits: 1, maximumFractionDigits: 1 });

/** A span of time as text: 0.3 s, 12 s, 4 min, 3 h.
 * @param {number} seconds */
export function span(seconds) {
  if (seconds < 9.95) return word("seconds", oneDigit.format(Math.max(0, seconds)));
  if (seconds < 120) return word("seconds", Math.floor(seconds));
  if (seconds < 7200) return word("minutes", Math.floor(seconds / 60));
  return word("hours", Math.floor(seconds / 3600));
}
