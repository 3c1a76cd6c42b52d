// What every page has. Most start here; a page with its own first module imports this afterwards.
import "../vendor/htmx.min.js";
import { draw, drawAll, rebind } from "./bind.js";
import * as attention from "./attention.js";
import * as control from "./control.js";
import * as drafts from "./drafts.js";
import * as fields from "./fields.js";
import * as find from "./find.js";
import * as focus from "./focus.js";
import * as kiosk from "./kiosk.js";
import * as live from "./live.js";
import * as quality from "./quality.js";
import * as redraw from "./redraw.js";
import * as review from "./review.js";
import * as setter from "./setter.js";
import * as visibility from "./visibility.js";

// On a phone the tabs are longer than the window: scroll them to the current page, and not the page to them.
for (const current of document.querySelectorAll(".tabs__tab[aria-current]")) {
  const { left, width } = current.getBoundingClientRect();
  const tabs = /** @type {HTMLElement} */ (current.closest(".tabs"));
  const shown = tabs.getBoundingClientRect();
  tabs.scrollBy({ left: left + width / 2 - shown.left - shown.width / 2, behavior: "instant" });
}
rebind();
visibility.start(draw, drawAll);
attention.start();
focus.start();
fields.start();
find.start();
quality.findUnits();
quality.start();
review.start();
drafts.start();
setter.start();
redraw.start();
control.start();
kiosk.start();
live.follow([
  ...new Set([...document.querySelectorAll("[data-watch-unit]")].map((element) => element.dataset.watchUnit)),
]);
live.start();

/** Start what few pages or devices need, where one does.
 * @param {boolean} isNeeded @param {() => Promise<{ start: () => void }>} load */
async function where(isNeeded, load) {
  if (isNeeded) (await load()).start();
}
const has = (/** @type {string} */ selector) => document.querySelector(selector) !== null;
where(navigator.maxTouchPoints > 0, () => import("./keypad.js"));
where(has("[data-people], [data-trace]"), () => import("./bus.js"));
where(has("[data-filter], [data-counts-one], [data-copy], [data-reload-as], [data-opened], #edit"), () => import("./editing.js"));

/** Sound where its settings are shown or kept in this browser, also by another page from now on.
 * @param {StorageEvent} [event] */
async function followSound(event) {
  if (event ? event.key !== "lineside-sound" : !has("[data-sound-on]") && !isSoundKept()) return;
  removeEventListener("storage", followSound);
  (await import("./sound.js")).start();
}
function isSoundKept() {
  try {
    return localStorage.getItem("lineside-sound") !== null;
  } catch {
    return false;
  }
}
addEventListener("storage", followSound);
followSound();

document.addEventListener("lineside:changed", quality.findUnits);
document.addEventListener("lineside:found", quality.findUnits);

// Only for the offline page; see sw.js. Browsers allow it on https and on this machine.
navigator.serviceWorker?.register("/sw.js").catch(() => {});
