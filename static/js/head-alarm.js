// The button in the head acknowledges the alarm that it stands beside. Where another alarm has just taken this place, a
// press is meant for the one before, and does nothing.
import { listen } from "./bind.js";

const SETTLES_MS = 1000;
let changedAt = Number.NEGATIVE_INFINITY;
/** @type {string | undefined} */
let shown;

export function start() {
  const button = document.querySelector("[data-head-acknowledge]");
  if (!button) return;
  listen("alarms_present", (fields) => {
    const acknowledge = /** @type {string | undefined} */ (fields.acknowledge);
    if (shown !== undefined && shown !== acknowledge) changedAt = performance.now();
    shown = acknowledge;
  });
  button.addEventListener("click", (event) => {
    if (performance.now() - changedAt < SETTLES_MS) event.preventDefault();
  });
}
