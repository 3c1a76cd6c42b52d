// What every page has. Most start here; a page with its own first module imports this afterwards.
import "../vendor/htmx.min.js";
import { draw, drawAll, rebind } from "./bind.js";
import * as blink from "./blink.js";
import * as control from "./control.js";
import * as drawer from "./drawer.js";
import * as drafts from "./drafts.js";
import * as counts from "./counts.js";
import * as find from "./find.js";
import * as focus from "./focus.js";
import * as keypad from "./keypad.js";
import * as kiosk from "./kiosk.js";
import * as live from "./live.js";
import * as people from "./people.js";
import * as quality from "./quality.js";
import * as redraw from "./redraw.js";
import * as review from "./review.js";
import * as setter from "./setter.js";
import * as visibility from "./visibility.js";
import * as timeLeft from "./time-left.js";
import * as sound from "./sound.js";
import * as announce from "./announce.js";
import * as trace from "./trace.js";
import * as verdict from "./verdict.js";

// On a phone the tabs are longer than the window: scroll them to the current page, and not the page to them.
for (const current of document.querySelectorAll(".tabs__tab[aria-current]")) {
  const { left, width } = current.getBoundingClientRect();
  const tabs = /** @type {HTMLElement} */ (current.closest(".tabs"));
  const shown = tabs.getBoundingClientRect();
  tabs.scrollBy({ left: left + width / 2 - shown.left - shown.width / 2, behavior: "instant" });
}
rebind();
visibility.start(draw, drawAll);
blink.start();
focus.start();
find.start();
quality.findUnits();
quality.start();
verdict.start();
sound.start();
review.start();
drawer.start();
drafts.start();
setter.start();
timeLeft.start();
trace.start();
people.start();
redraw.start();
announce.start();
control.start();
counts.start();
keypad.start();
kiosk.start();
live.follow([
  ...new Set([...document.querySelectorAll("[data-watch-unit]")].map((element) => element.dataset.watchUnit)),
]);
live.start();
document.addEventListener("lineside:changed", quality.findUnits);
document.addEventListener("lineside:found", quality.findUnits);

// Only for the offline page; see sw.js. Browsers allow it on https and on this machine.
navigator.serviceWorker?.register("/sw.js").catch(() => {});
