// A panel on the wall: full screen, awake while it is shown, dark when nobody is there. The first touch after dark
// wakes and does nothing else; while the glass is cleaned, touching does nothing at all.
import { listen } from "./bind.js";
import { word } from "./words.js";

const GUARD_MS = 2 * 60_000;
const DARK_MS = 10 * 60_000;
const HOME_MS = 5 * 60_000;
const CLEAN_S = 30;
const LOOK_MS = 5_000;
const TOUCHES = ["pointerdown", "pointerup", "click", "keydown", "touchstart", "wheel"];

const home = document.body.dataset.panel;
let touchedAt = performance.now();
let cover = null;
let verdict = "";

// --- awake ------------------------------------------------------------------------------------------------

async function stayAwake() {
  if (document.visibilityState !== "visible") return;
  try {
    await navigator.wakeLock?.request("screen");
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

function lay(className, text) {
  uncover();
  cover = document.createElement("div");
  cover.className = `cover ${className}`;
  if (text) {
    const words = document.createElement("p");
    words.textContent = text;
    cover.append(words);
  }
  document.body.append(cover);
}

function uncover() {
  cover?.remove();
  cover = null;
}

function swallow(event) {
  if (cover) {
    event.preventDefault();
    event.stopImmediatePropagation();
    if (cover.dataset.cleaning === undefined && (event.type === "click" || event.type === "keydown"))
      uncover();
  }
  touchedAt = performance.now();
}

function look() {
  const idle = performance.now() - touchedAt;
  if (cover?.dataset.cleaning !== undefined || document.querySelector("dialog[open]")) return;
  if (idle > HOME_MS && location.pathname !== home) location.assign(home);
  else if (idle > DARK_MS && !cover?.classList.contains("cover--dark")) lay("cover--dark", verdict);
  else if (idle > GUARD_MS && !cover) lay("cover--guard", "");
}

function clean() {
  let left = CLEAN_S;
  lay("cover--clean", word("cleaning", left));
  cover.dataset.cleaning = "";
  cover.setAttribute("role", "status");
  const timer = setInterval(() => {
    left -= 1;
    if (left > 0) cover.firstChild.textContent = word("cleaning", left);
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
  if (home === undefined) return;
  listen("line", (fields) => {
    verdict = fields.verdict ?? "";
    if (fields.level && cover?.classList.contains("cover--dark")) uncover();
  });
  stayAwake();
  document.addEventListener("visibilitychange", stayAwake);
  setInterval(look, LOOK_MS);
}
