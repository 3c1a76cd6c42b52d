// Draws units outside the window once a second, which leaves main-thread time for what is visible. Before a unit
// becomes visible it is brought up to date, in the frame that scrolls, resizes or prints.
//   data-unit="dry-end/1" data-only    whatever the page shows of this unit is in this element, or in its faceplate

const LATE_MS = 1000;
const AHEAD = "10% 0px";
/** By hidden unit, when its next drawing is due.
 * @type {Map<string, number>} */
const due = new Map();
let beside = "";

/** The unit whose faceplate is visible, wherever the window is; empty for none.
 * @param {string} unit */
export function show(unit) {
  beside = unit;
}

/** Whether a unit is outside the window and its next drawing is not due yet.
 * @param {string} unit */
export function mayWait(unit) {
  const at = due.get(unit);
  if (at === undefined || unit === beside) return false;
  const now = performance.now();
  if (now < at) return true;
  due.set(unit, now + LATE_MS);
  return false;
}

/** Call `draw` when units may have become visible, and `drawAll` when anything may have.
 * @param {() => void} draw @param {() => void} drawAll */
export function start(draw, drawAll) {
  let turn = 0;
  const watcher = new IntersectionObserver(
    (entries) => {
      let seen = false;
      for (const { target, isIntersecting } of entries) {
        const { unit } = /** @type {HTMLElement} */ (target).dataset;
        if (isIntersecting) seen = due.delete(unit) || seen;
        // Not all in the same moment: a quarter of them at a time.
        else due.set(unit, performance.now() + (LATE_MS * (1 + (turn++ % 4))) / 4);
      }
      if (seen) draw();
    },
    { rootMargin: AHEAD },
  );
  const alone = document.querySelectorAll("[data-unit][data-only]");
  if (!alone.length) return;
  for (const element of alone) watcher.observe(element);
  document.addEventListener("scroll", drawAll, { capture: true, passive: true });
  for (const event of ["resize", "beforeprint", "pageshow"]) addEventListener(event, drawAll);
}
