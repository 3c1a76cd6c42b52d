// A panel on the wall: full screen, awake while it is shown, dark when unused. The first touch after dark
// wakes and does nothing else; while the glass is cleaned, touching does nothing at all.
import { listen } from "./bind.js";
import { isLive } from "./live.js";
import { word } from "./words.js";

const GUARD_MS = 2 * 60_000;
const DARK_MS = 10 * 60_000;
const HOME_MS = 5 * 60_000;
const CLEAN_S = 30;
const LOOK_MS = 5_000;
const WAKING_MS = 400;
const TOUCHES = ["pointerdown", "pointerup", "touchstart", "touchend", "click", "keydown", "keyup", "wheel"];
const LAST_OF_A_TOUCH = ["pointerup", "click", "keyup", "wheel"];
const WENT_HOME = "lineside-went-home";

const home = document.body.dataset.panel;
let touchedAt = performance.now();
let isHome = false;
/** @type {HTMLElement | null} */
let cover = null;
let waking = 0;
let verdict = "";
let level = "";

// --- awake ------------------------------------------------------------------------------------------------

/** @type {WakeLockSentinel | null} */
let lock = null;

async function stayAwake() {
  if (document.visibilityState !== "visible" || (lock && !lock.released)) return;
  try {
    lock = (await navigator.wakeLock?.request("screen")) ?? null;
  } catch {
    // The browser would not: the panel's own settings decide.
  }
}

async function toggleFullScreen() {
  if (document.fullscreenElement) return document.exitFullscreen();
  await document.documentElement.requestFullscreen();
  return stayAwake();
}

// --- a cover over the page --------------------------------------------------------------------------------

/** @param {string} className @param {Node[]} lines */
function lay(className, ...lines) {
  uncover();
  // A menu that is open lies over everything.
  for (const menu of /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll(":popover-open")))
    menu.hidePopover();
  cover = document.createElement("div");
  cover.className = `cover ${className}`;
  cover.append(...lines);
  document.body.append(cover);
  return cover;
}

/** @param {string} text */
function line(text, className = "") {
  const words = document.createElement("p");
  words.className = className;
  words.textContent = text;
  return words;
}

/** With the server's clock, which live.js keeps going: a panel that stands still shows that in the dark, too. */
function darken() {
  const clock = line("", "cover__clock");
  clock.dataset.clock = "";
  lay("cover--dark", line(verdict), clock, line(word("wake"), "cover__hint"));
}

function uncover() {
  clearTimeout(waking);
  waking = 0;
  cover?.remove();
  cover = null;
}

/** A touch is several events, and a browser makes the click of it last or, once prevented, not at all: the cover
 * stays until all of them are over.
 * @param {Event} event */
function swallow(event) {
  touchedAt = performance.now();
  isHome = false;
  if (!cover) return;
  event.preventDefault();
  event.stopImmediatePropagation();
  if (cover.dataset.cleaning !== undefined || !LAST_OF_A_TOUCH.includes(event.type)) return;
  if (!waking) waking = setTimeout(uncover, WAKING_MS);
}

const isDark = () => cover?.classList.contains("cover--dark") ?? false;

function look() {
  if (cover?.dataset.cleaning !== undefined || !isLive()) return;
  const idle = performance.now() - touchedAt;
  if (idle > GUARD_MS) document.dispatchEvent(new CustomEvent("lineside:idle"));
  if (idle > HOME_MS && goHome()) return;
  if (idle > DARK_MS && !isDark() && !needsAttention()) darken();
  else if (idle > GUARD_MS && !cover) lay("cover--guard");
}

/** An abnormal state keeps the screen on. */
const needsAttention = () => level === "urgent" || level === "high";

/** To the panel's own page, once until it is touched again. */
function goHome() {
  if (isHome || home === undefined || `${location.pathname}${location.search}` === home) return false;
  sessionStorage.setItem(WENT_HOME, "");
  location.assign(home);
  return true;
}

/** Whether the page was opened automatically, after the panel was unused for the time to go home. */
function arrive() {
  isHome = sessionStorage.getItem(WENT_HOME) !== null;
  sessionStorage.removeItem(WENT_HOME);
  if (isHome) touchedAt -= HOME_MS;
}

function clean() {
  let left = CLEAN_S;
  const words = line(word("cleaning", left));
  const laid = lay("cover--clean", words);
  laid.dataset.cleaning = "";
  laid.setAttribute("role", "timer");
  const timer = setInterval(() => {
    left -= 1;
    if (left > 0) words.textContent = word("cleaning", left);
    else {
      clearInterval(timer);
      uncover();
    }
  }, 1000);
}

export function start() {
  for (const type of TOUCHES) addEventListener(type, swallow, { capture: true, passive: false });
  document.addEventListener("click", (event) => {
    if (event.target.closest("[data-clean]")) clean();
    if (event.target.closest("[data-full-screen]")) toggleFullScreen();
  });
  for (const item of document.querySelectorAll("[data-full-screen-item]"))
    item.hidden = !document.fullscreenEnabled;
  const isWall = document.querySelector("[data-wall]") !== null;
  if (home === undefined && !isWall) return;
  stayAwake();
  document.addEventListener("visibilitychange", stayAwake);
  // A wallboard is read from afar, and never touched: it neither darkens nor goes anywhere.
  if (isWall) return;
  arrive();
  listen("line_summary", (fields) => {
    verdict = fields.verdict ?? "";
    level = fields.level ?? "";
    if (!isDark()) return;
    if (needsAttention()) uncover();
    else cover?.firstElementChild?.replaceChildren(verdict);
  });
  document.addEventListener("lineside:lost", () => isDark() && uncover());
  setInterval(look, LOOK_MS);
}
