// Which units nobody can see: what is scrolled away is drawn once a second, so a slow device has its time for what
// is looked at. Before any of it is seen it is up to date: in the frame that scrolls, sizes or prints it.
//   data-unit="dry-end/1" data-only    whatever the page shows of this unit is in this element

const LATE_MS = 1000;
const AHEAD = "10% 0px";
/** Of each unit out of sight: when it is due. */
const due = new Map();

/** Whether nobody would see it if this unit were drawn now, and it is not due. */
export function mayWait(unit) {
  const at = due.get(unit);
  if (at === undefined) return false;
  const now = performance.now();
  if (now < at) return true;
  due.set(unit, now + LATE_MS);
  return false;
}

/** Call `draw` when units may have come into sight: of those, and `drawAll` of everything. */
export function start(draw, drawAll) {
  let turn = 0;
  const watcher = new IntersectionObserver(
    (entries) => {
      let seen = false;
      for (const { target, isIntersecting } of entries) {
        if (isIntersecting) seen = due.delete(target.dataset.unit) || seen;
        // Not all in the same moment: a quarter of them at a time.
        else due.set(target.dataset.unit, performance.now() + (LATE_MS * (1 + (turn++ % 4))) / 4);
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
