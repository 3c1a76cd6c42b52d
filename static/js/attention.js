// What changes by itself on every page: marks that blink together, times that are counted down, the verdict in the title of
// the tab, and what a screen reader is told.
import { listen, value } from "./bind.js";
import * as clock from "./clock.js";
import { put, word } from "./words.js";

export function start() {
  blink();
  announceSwapped();
  followVerdict();
  countDown();
}

// --- marks of alarms ----------------------------------------------------------------------------------------
// Lets all marks of active alarms that are not acknowledged blink together: two changes of style a second for a page
// that has one. An animation for each mark costs a layer each, and every drawing of a page with many marks pays for them.
const HALF_MS = 500;
const BLINKS = '.alarm-priority[data-is$="waiting"]:not([data-is*="cleared"])';

function blink() {
  const root = document.documentElement;
  setInterval(() => {
    root.toggleAttribute("data-blink", !root.hasAttribute("data-blink") && document.querySelector(BLINKS) !== null);
  }, HALF_MS);
}

// --- what a screen reader is told ---------------------------------------------------------------------------
// Announces the result of a part that is swapped in once: data-announce holds the text. Few screen readers read a
// live region that is inserted together with its text, and one that counts would never stop. The verdict of the line
// has another region: of two texts that are put into one at the same moment, the first would be lost.
const swapped = () => document.querySelector("[data-announce]")?.dataset.announce ?? "";

function announceSwapped() {
  let last = swapped();
  document.addEventListener("htmx:after:swap", () => {
    const now = swapped();
    if (now && now !== last) document.getElementById("announcement").textContent = now;
    last = now;
  });
}

// --- the verdict --------------------------------------------------------------------------------------------
// The verdict outside of its place on the page: in the title of the tab, and spoken by a screen reader.
const title = document.title;

/** A translation of the page writes a title, too.
 * @param {number} abnormal */
function entitle(abnormal) {
  const present = abnormal > 0 ? `(${abnormal}) ${title}` : title;
  if (document.title !== present) document.title = present;
}

/** To a screen reader: only when more or fewer units are abnormal or the worst has another priority, never at first, and not
 * each unit on its ramp.
 * @param {string} verdict */
function speak(verdict) {
  const place = document.getElementById("verdict");
  if (place) place.textContent = verdict;
}

function followVerdict() {
  /** @type {string | undefined} */
  let known;
  listen("line_summary", (fields) => {
    entitle(Number(fields.abnormal));
    const now = `${fields.abnormal} ${fields.level}`;
    if (known !== undefined && now !== known) speak([fields.verdict, fields.counts].filter(Boolean).join(" · "));
    known = now;
  });
}

// --- times left ---------------------------------------------------------------------------------------------
// Counts down to a moment of the server's clock: data-until="Unix seconds", or the field that data-until-live names.
// What has data-ends is hidden at the end.
const MINUTES_FROM_S = 120;

/** Minutes, at the end seconds.
 * @param {number} seconds */
const left = (seconds) =>
  seconds < MINUTES_FROM_S ? word("seconds", seconds) : word("minutes", Math.floor(seconds / 60));

function count() {
  for (const text of document.querySelectorAll("[data-until]")) {
    const { until, untilLive } = text.dataset;
    const seconds = Math.round(Number((untilLive && value(untilLive)) || until) - clock.now());
    const words = left(Math.max(0, seconds));
    put(text, words);
    const ended = seconds <= 0 && text.closest("[data-ends]");
    if (ended) ended.dataset.over = "";
  }
}

function countDown() {
  document.addEventListener("htmx:after:swap", count);
  setInterval(count, 1000);
}
