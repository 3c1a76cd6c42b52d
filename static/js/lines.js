// The page of all lines. Their order is the worst first; it changes only while no one is at the page, so that nothing
// moves under a finger.
//   data-lines                    the list; live.js requests the lines from the server for a page that has it
//   data-line="line_of/dry-end"   one line; its field `rank` is its place in the list
import { fieldsOf } from "./bind.js";

const IDLE_MS = 10_000;
const SORT_MS = 2_000;
const list = document.querySelector("[data-lines]");
let touchedAt = performance.now() - IDLE_MS;

/** @param {Element} item */
function rankOf(item) {
  const line = item.querySelector("[data-line]")?.dataset.line ?? "";
  return Number(fieldsOf(line)?.rank ?? Number.MAX_SAFE_INTEGER);
}

function sort() {
  if (!list || performance.now() - touchedAt < IDLE_MS) return;
  const items = [...list.children];
  const sorted = items.toSorted((one, other) => rankOf(one) - rankOf(other));
  if (sorted.every((item, place) => item === items[place])) return;
  const focused = document.activeElement;
  list.append(...sorted);
  if (focused instanceof HTMLElement && list.contains(focused)) focused.focus({ preventScroll: true });
}

/** Whether one of the lines has come or gone since the page was opened. @param {string[]} keys */
function isOther(keys) {
  const isComplete = list?.dataset.filtered === undefined;
  return keys.some((key) => {
    const isShown = document.querySelector(`[data-line="${CSS.escape(key)}"]`) !== null;
    return fieldsOf(key)?.quality === "gone" ? isShown : isComplete && !isShown;
  });
}

for (const event of ["pointerdown", "pointermove", "keydown", "wheel", "touchstart", "scroll"])
  addEventListener(
    event,
    () => {
      touchedAt = performance.now();
    },
    { passive: true, capture: true },
  );
document.addEventListener("lineside:lines", ({ detail }) => {
  if (list && isOther(detail)) location.reload();
});
setInterval(sort, SORT_MS);
