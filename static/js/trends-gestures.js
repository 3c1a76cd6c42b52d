// Wheel, pinch, drag and keys on the picture, turned into changes of the view.
const WHEEL_STEP = 1.2;
/** Pixels that a press may move and still be one. */
const STILL = 4;
const PULLED = "trends__picture--pulled";
const KEY_STEP = 0.01;
const KEY_PAN = 0.25;

/** `time(clientX)` gives the time at a place; `cursor` has `at` and `put(seconds)`; `item` opens what is at a place
 * above the curves, and returns whether there was something.
 * @param {HTMLElement} element @param {View} view @param {TimeAt} time @param {Cursor} cursor
 * @param {(event: MouseEvent) => boolean} item */
export function gestures(element, view, time, cursor, item) {
  element.addEventListener("wheel", (event) => wheel(event, view, time), { passive: false });
  pull(element, view, time, (event) => item(event) || press(view, time(event.clientX)));
  element.addEventListener("keydown", (event) => key(event, view, cursor));
}

/** With Ctrl (so does a pinch on a touchpad) it zooms, sideways or with Shift it moves the picture; else the page.
 * @param {WheelEvent} event @param {View} view @param {TimeAt} time */
function wheel(event, view, time) {
  const sideways = event.shiftKey ? event.deltaY || event.deltaX : event.deltaX;
  if (event.ctrlKey) view.zoom(event.deltaY > 0 ? WHEEL_STEP : 1 / WHEEL_STEP, time(event.clientX));
  else if (event.shiftKey || Math.abs(sideways) > Math.abs(event.deltaY)) view.pan(Math.sign(sideways) * 0.1);
  else return;
  event.preventDefault();
}

/** The mouse or a finger pulls the picture, two fingers pinch; with Shift the mouse selects a span (uPlot's own). What
 * did not move is pressed.
 * @param {HTMLElement} element @param {View} view @param {TimeAt} time @param {(event: MouseEvent) => void} pressed */
function pull(element, view, time, pressed) {
  /** Where each pointer is. @type {Map<number, number>} */
  const held = new Map();
  let isMoving = false;
  element.addEventListener("pointerdown", ({ pointerId, pointerType, button, shiftKey, clientX }) => {
    if (pointerType === "mouse" && (shiftKey || button > 1)) return;
    isMoving = held.size > 0;
    held.set(pointerId, clientX);
    element.classList.add(PULLED);
  });
  element.addEventListener("pointermove", ({ pointerId, clientX }) => {
    const from = held.get(pointerId);
    if (from === undefined || (!isMoving && Math.abs(clientX - from) <= STILL)) return;
    if (!isMoving) element.setPointerCapture(pointerId);
    isMoving = true;
    const before = [...held.values()];
    held.set(pointerId, clientX);
    const after = [...held.values()];
    if (after.length === 1) view.pan((before[0] - after[0]) / element.clientWidth);
    else pinch(view, time, before, after);
  });
  for (const name of /** @type {const} */ (["pointerup", "pointercancel", "pointerleave"]))
    element.addEventListener(name, ({ pointerId }) => {
      held.delete(pointerId);
      element.classList.toggle(PULLED, held.size > 0);
    });
  element.addEventListener("click", (event) => event.shiftKey || isMoving || pressed(event));
}

/** The first press sets cursor A, the next B, the third takes both away.
 * @param {View} view @param {number} at */
function press(view, at) {
  if (view.a === null) view.change({ a: at });
  else if (view.b === null) view.change({ b: at });
  else view.change({ a: null, b: null });
}

/** @param {View} view @param {TimeAt} time @param {number[]} before @param {number[]} after */
function pinch(view, time, before, after) {
  const apart = Math.abs(after[0] - after[1]);
  if (apart > 10) view.zoom(Math.abs(before[0] - before[1]) / apart, time((after[0] + after[1]) / 2));
}

/** @param {KeyboardEvent} event @param {View} view @param {Cursor} cursor */
function key(event, view, cursor) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const [from, to] = view.range();
  const side = /** @type {Record<string, number>} */ ({ ArrowLeft: -1, ArrowRight: 1 })[event.key];
  const at = cursor.at ?? (from + to) / 2;
  if (side && event.shiftKey) view.pan(side * KEY_PAN);
  else if (side) cursor.put(Math.min(to, Math.max(from, at + side * KEY_STEP * (to - from))));
  else if (event.key === "+") view.zoom(0.5, cursor.at ?? undefined);
  else if (event.key === "-") view.zoom(2, cursor.at ?? undefined);
  else if (event.key === "a" || event.key === "A") view.change({ a: at });
  else if (event.key === "b" || event.key === "B") view.change({ b: at });
  else if (event.key === "Escape") view.change({ a: null, b: null });
  else if (event.key === "l" || event.key === "L") view.toggleLive();
  else return;
  event.preventDefault();
}
