// Caps rendering at a fixed share of main-thread time, so that input stays responsive on slow devices; a fast device
// renders at once. Changes that arrive meanwhile are drawn together, the newest of each.

/** The part of the main thread that drawing may take; receiving messages comes on top. */
const SHARE = 0.15;
/** A device that draws within so many ms, a third of a frame, is fast: input never waits long, so it may take more. */
const FAST_MS = 5;
const FAST_SHARE = 0.25;
/** Drawings may be this far ahead of their share: a few cheap ones in a row wait for nothing. */
const AHEAD_MS = 200;
/** Nothing waits longer, however slow the device is. */
const LONGEST_MS = 600;
/** A cost is judged beside the few before it, because something else may have been in between: */
const REMEMBERED = 4;
/** More than so many times the least of them was not drawing. */
const CREDIBLE = 2;

/** @type {number[]} */
const costs = [];
let paid = 0;
let timer = 0;
let measuring = false;
const after = new MessageChannel();

/** What the last drawing cost, in ms, as far as the costs of the last few, oldest first, make it credible.
 * @param {number[]} known */
export function credible(known) {
  const least = Math.min(...known);
  return known.length < REMEMBERED ? 0 : Math.min(known.at(-1) ?? 0, CREDIBLE * least);
}

/** Return the time until which drawing has used up its share, after a drawing of `cost` that began at `began`; all
    in ms. `until` is the former value.
 * @param {number} until @param {number} began @param {number} cost */
export function usedUp(until, began, cost) {
  const share = cost <= FAST_MS ? FAST_SHARE : SHARE;
  return Math.min(Math.max(until, began) + cost / share, began + LONGEST_MS + AHEAD_MS);
}

/** When the next drawing may start, from the share used so far.
 * @param {number} until */
export const readyAt = (until) => until - AHEAD_MS;

/** Measure from the writing to the end of the frame: the browser paints after the callbacks of the frame, and lays out
    before them where a pointer is over the page, to find the element below it.
 * @param {number} wrote */
function measure(wrote) {
  if (measuring || document.hidden) return;
  measuring = true;
  const written = performance.now();
  requestAnimationFrame((frame) => {
    const began = Math.max(written, frame);
    after.port1.onmessage = () => {
      measuring = false;
      costs.push(wrote + performance.now() - began);
      if (costs.length > REMEMBERED) costs.shift();
    };
    after.port2.postMessage(0);
  });
}

/** @param {() => boolean} draw */
function run(draw) {
  timer = 0;
  const began = performance.now();
  if (!draw()) return;
  paid = usedUp(paid, began, credible(costs));
  measure(performance.now() - began);
}

/** Call `draw` now, or as soon as its share allows; once, however often it is requested until then. `draw` returns
    whether it drew anything: invisible changes cost no frame.
 * @param {() => boolean} draw */
export function soon(draw) {
  if (timer) return;
  const wait = readyAt(paid) - performance.now();
  if (wait <= 0) run(draw);
  else timer = setTimeout(run, wait, draw);
}
