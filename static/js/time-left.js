// Counts down to a moment of the server's clock: data-until="Unix seconds", or the field that data-until-live names.
// What has data-ends is hidden at the end.
import { value } from "./bind.js";
import * as clock from "./clock.js";
import { put, word } from "./words.js";

const MINUTES_FROM_S = 120;

/** Minutes, at the end seconds.
 * @param {number} seconds */
export const left = (seconds) =>
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

export function start() {
  document.addEventListener("htmx:after:swap", count);
  setInterval(count, 1000);
}
