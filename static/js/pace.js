// How often this device may be given something to draw. A quick one draws what it is told at once; one that takes
// long is left time for the finger between two pictures: what came meanwhile is drawn together, the newest of each.

/** Cheaper pictures follow each other freely; above it, so many times the excess lies from one to the next. */
const FREE_MS = 5;
const REST = 8;
/** Nothing waits longer, however slow the device is: what changes four times a second is seen four times a second. */
const LONGEST_MS = 240;
/** The least of the last few counts, because something else may have been in between. */
const REMEMBERED = 4;

const costs = [];
let ready = 0;
let timer = 0;
let measuring = false;
const after = new MessageChannel();

const rest = () => {
  const cost = costs.length < REMEMBERED ? 0 : Math.min(...costs);
  return Math.min(LONGEST_MS, Math.max(0, cost - FREE_MS) * REST);
};

/** Measure from the writing to the end of the frame: the browser lays out and paints after the frame's callbacks. */
function measure(wrote) {
  if (measuring || document.hidden) return;
  measuring = true;
  requestAnimationFrame(() => {
    const began = performance.now();
    after.port1.onmessage = () => {
      measuring = false;
      costs.push(wrote + performance.now() - began);
      if (costs.length > REMEMBERED) costs.shift();
    };
    after.port2.postMessage(0);
  });
}

function run(draw) {
  timer = 0;
  const began = performance.now();
  draw();
  ready = began + rest();
  measure(performance.now() - began);
}

/** Call `draw` now, or as soon as the device has rested; once, however often it is asked for until then. */
export function soon(draw) {
  if (timer) return;
  const wait = ready - performance.now();
  if (wait <= 0) run(draw);
  else timer = setTimeout(run, wait, draw);
}
