// The strip of what is abnormal: empty when all is well, and always of the same height.
import { listen } from "./bind.js";

const title = document.title;

/** @param {string} level */
function drawing(level) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  const use = document.createElementNS("http://www.w3.org/2000/svg", "use");
  use.setAttribute("href", `${document.body.dataset.sprite}#${level}`);
  svg.setAttribute("class", "icon");
  svg.setAttribute("aria-hidden", "true");
  svg.append(use);
  return svg;
}

/** @param {StripEntry} entry */
function entry([key, level, name, text, since]) {
  const link = document.createElement("a");
  link.className = "mark strip__item";
  link.dataset.level = level;
  link.href = key.includes("/") ? `/units/${key}` : `/bus/${key}`;
  const strong = document.createElement("b");
  strong.textContent = name;
  const words = document.createElement("span");
  words.textContent = text;
  const began = document.createElement("small");
  began.textContent = since;
  link.append(drawing(level), strong, words, began);
  const item = document.createElement("li");
  item.append(link);
  return item;
}

/** A translation of the page writes a title, too.
 * @param {number} abnormal */
function entitle(abnormal) {
  const present = abnormal > 0 ? `(${abnormal}) ${title}` : title;
  if (document.title !== present) document.title = present;
}

/** @param {StripEntry[]} strip */
function draw(strip) {
  for (const list of document.querySelectorAll("[data-strip]")) {
    const active = /** @type {HTMLAnchorElement} */ (document.activeElement);
    const focused = list.contains(active) ? active.href : null;
    list.replaceChildren(...strip.map(entry));
    if (focused) [...list.querySelectorAll("a")].find((link) => link.href === focused)?.focus();
  }
}

/** To a screen reader: only when it is more or less than before, never at first, and not each unit on its ramp.
 * @param {string} verdict */
function announce(verdict) {
  const place = document.getElementById("verdict");
  if (place) place.textContent = verdict;
}

export function start() {
  /** @type {string | undefined} */
  let known;
  listen("line_summary", (fields, changed) => {
    entitle(Number(fields.abnormal));
    if ("strip" in changed) draw(fields.strip ?? []);
    if (known !== undefined && fields.abnormal !== known) announce([fields.verdict, fields.counts].filter(Boolean).join(" · "));
    known = fields.abnormal ?? known;
  });
}
