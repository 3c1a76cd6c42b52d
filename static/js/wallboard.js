// The wallboard: its lines in turn, and a verdict as large as its words allow.
//   data-wall      the page; data-wall="all": every line, of which one is shown at a time
//   data-line      one line; data-turn: the link to it
//   data-held      the word that only urgent lines are shown in turn
//   data-fitted    words that take the largest of a few sizes in which all of them have room
import { fieldsOf, listen } from "./bind.js";

const TURN_MS = 12_000;
const SIZES = 5;
const wall = document.querySelector("[data-wall]");
const lines = [...(wall?.querySelectorAll("[data-line]") ?? [])];
const isAll = wall?.dataset.wall === "all";
let turnedAt = performance.now();

/** The next size as long as something is cut off.
 * @param {HTMLElement} words */
function fit(words) {
  for (let size = 0; size < SIZES; size++) {
    words.dataset.fitted = String(size);
    const { scrollHeight, clientHeight, scrollWidth, clientWidth } = words;
    if (scrollHeight <= clientHeight + 1 && scrollWidth <= clientWidth + 1) return;
  }
}

/** @param {HTMLElement} line */
function fitIn(line) {
  for (const words of line.querySelectorAll("[data-fitted]")) fit(words);
}

const fitAll = () => lines.forEach(fitIn);

/** @param {HTMLElement} line */
function show(line) {
  turnedAt = performance.now();
  for (const each of lines) each.hidden = each !== line;
  for (const link of document.querySelectorAll("[data-turn]"))
    link.toggleAttribute("data-shown", link.dataset.turn === line.dataset.line);
  fitIn(line);
}

function turn() {
  // Whoever looks up for a moment must not read that all is well.
  const urgent = lines.filter((line) => fieldsOf(line.dataset.line ?? "")?.level === "urgent");
  document.querySelector("[data-held]")?.toggleAttribute("hidden", !urgent.length || urgent.length === lines.length);
  if (performance.now() - turnedAt < TURN_MS) return;
  const turning = urgent.length ? urgent : lines;
  const shown = turning.findIndex((line) => !line.hidden);
  show(/** @type {HTMLElement} */ (turning[(shown + 1) % turning.length]));
}

/** @param {HTMLElement} line */
function follow(line) {
  let level = "";
  listen(line.dataset.line ?? "", (fields, changed) => {
    const isUrgent = fields.level === "urgent" && level !== "urgent";
    level = String(fields.level ?? "");
    if (isAll && isUrgent) show(line);
    // Once the texts are written.
    if (["verdict", "place", "last", "abnormal", "event", "recipe"].some((field) => field in changed))
      requestAnimationFrame(() => fitIn(line));
  });
}

lines.forEach(follow);
addEventListener("resize", fitAll);
document.fonts.ready.then(fitAll);
document.addEventListener("lineside:lines", ({ detail }) => {
  const known = lines.map((line) => line.dataset.line);
  /** @param {string} key */
  const isOther = (key) => known.includes(key) === (fieldsOf(key)?.quality === "gone");
  if (isAll && detail.some(isOther)) location.reload();
});
if (isAll && lines.length > 1) {
  show(lines[0]);
  setInterval(turn, 500);
}
