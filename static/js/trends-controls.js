// What changes the view: the controls around the picture, gestures and keys on it; and the form for a note.
import { exportAddress, writeNote } from "./trends-data.js";
import { fromField, toField } from "./trends-time.js";
import { listOf } from "./trends-values.js";
import { MAX_VALUES } from "./trends-view.js";

const WHEEL_STEP = 1.2;
/** Pixels that a press may move and still be one. */
const STILL = 4;
const PULLED = "trends__picture--pulled";
const KEY_STEP = 0.01;
const KEY_PAN = 0.25;

/** By what a button moves: data-move. @type {Record<string, (view: View) => void>} */
const MOVES = {
  back: (view) => view.pan(-0.5),
  on: (view) => view.pan(0.5),
  in: (view) => view.zoom(0.5),
  out: (view) => view.zoom(2),
  live: (view) => view.toggleLive(),
};

/** What a button beside a value does with its series, or those below the legend with the dimmed ones: data-act.
 * @type {Record<string, (trends: Trends, key: string) => void>} */
const ACTS = {
  remove: ({ view }, key) => view.remove(key),
  choose: (trends, key) => Object.assign(trends, { chosen: key }),
  toggle: ({ dimmed }, key) => dimmed.delete(key) || dimmed.add(key),
  only: (trends, key) => {
    const others = trends.view.series.filter((other) => other !== key);
    const isAlone = !trends.dimmed.has(key) && others.every((other) => trends.dimmed.has(other));
    trends.dimmed = new Set(isAlone ? [] : others);
  },
  brighten: ({ dimmed }) => dimmed.clear(),
  removeDimmed: ({ view, dimmed }) => {
    view.remove(...dimmed);
    dimmed.clear();
  },
};

/** Let the controls of the page change what is shown. `explain` shows why nothing was changed, or ""; `draw` draws all again.
 * @param {HTMLElement} root @param {Trends} trends @param {(fault: string) => void} explain @param {() => void} draw */
export function bindControls(root, trends, explain, draw) {
  const { view, words } = trends;
  root.addEventListener("click", ({ target }) => {
    /** @type {Record<string, string | undefined>} */
    const { span, preset, move, act, of = "" } = target.closest("button")?.dataset ?? {};
    if (span) view.follow(Number(span));
    else if (preset) view.showPreset(preset);
    else if (move) MOVES[move](view);
    else if (target.closest("#trend-copy")) copyLink(view, words);
    else if (act) {
      ACTS[act](trends, of);
      draw();
    }
  });
  onSubmit(document.getElementById("trend-exact"), ({ elements: { from, to } }) => {
    const [start, end] = [fromField(from.value), fromField(to.value)];
    explain(Number.isNaN(end - start) ? words.malformed : end <= start ? words.backwards : "");
    if (end > start) view.show(start, end);
  });
  onSubmit(document.getElementById("trend-add"), ({ elements: { unit, value } }) => {
    if (view.series.length >= MAX_VALUES) explain(words.full);
    else view.add(`${unit.value}/${value.value}`);
  });
  const [scale, marks] = [document.getElementById("trend-scale"), document.getElementById("trend-marks")];
  const compare = document.getElementById("trend-compare");
  scale.onchange = () => view.change({ scale: scale.value });
  compare.onchange = () => view.change({ compare: compare.value });
  marks.onchange = () => view.change({ marks: marks.checked });
}

/** @template {HTMLFormElement} T @param {T} form @param {(form: T) => void} act */
const onSubmit = (form, act) =>
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    act(form);
  });

/** The view whose link was copied. */
let copied = "";

/** Without https a browser has no clipboard but the selection of a field. @param {View} view @param {TrendWords} words */
function copyLink(view, words) {
  const link = document.getElementById("trend-link");
  link.value = view.link();
  link.hidden = false;
  link.select();
  link.hidden = document.execCommand("copy");
  sayCopied(link.hidden ? words.copied : "");
  copied = String(view.query());
}

/** Say that the link was copied, or no longer: to eyes within the button, which keeps its width, so that nothing moves.
 * @param {string} text */
function sayCopied(text) {
  const button = document.getElementById("trend-copy");
  const { label = "", copied: done = "" } = button.dataset;
  if (text) button.style.minInlineSize = `${button.offsetWidth}px`;
  button.textContent = text ? done : label;
  button.title = text;
  document.getElementById("trend-copied").textContent = text;
}

/** Show in the controls what the view is. @param {HTMLElement} root @param {Trends} trends */
export function showControls(root, { view, range }) {
  const spans = view.live && !view.preset && view.from === null;
  /** @param {string} name @param {(value: string) => boolean} isPressed */
  const press = (name, isPressed) => {
    for (const button of root.querySelectorAll(`[data-${name}]`)) button.ariaPressed = String(isPressed(button.dataset[name] ?? ""));
  };
  press("span", (span) => spans && Number(span) === view.span);
  press("preset", (preset) => preset === view.preset);
  root.querySelector("[data-move=live]").ariaPressed = String(view.live);
  const exact = document.getElementById("trend-exact");
  if (!exact.contains(document.activeElement)) {
    exact.elements.from.value = toField(range[0]);
    exact.elements.to.value = toField(range[1]);
  }
  document.getElementById("trend-scale").value = view.scale;
  document.getElementById("trend-compare").value = view.compare;
  document.getElementById("trend-marks").checked = view.marks;
  if (copied !== String(view.query())) sayCopied("");
  document.getElementById("trend-save").elements.query.value = String(view.query());
  for (const file of ["csv", "data", "parquet"]) {
    const link = /** @type {HTMLAnchorElement | null} */ (document.getElementById(`export-${file}`));
    if (link) link.href = exportAddress(view.series, range, file);
  }
}

/** Let wheel, fingers, mouse and keys on the picture change the view. `time(clientX)` gives the time at a place, `put(seconds)`
 * moves the cursor.
 * @param {HTMLElement} element @param {Trends} trends @param {TimeAt} time @param {(seconds: number) => void} put */
export function bindGestures(element, trends, time, put) {
  element.addEventListener("wheel", (event) => wheel(event, trends.view, time), { passive: false });
  element.addEventListener("keydown", (event) => key(event, trends, put));
  pull(element, trends.view, time);
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
 * @param {HTMLElement} element @param {View} view @param {TimeAt} time */
function pull(element, view, time) {
  /** Where each pointer is. @type {Map<number, number>} */
  const held = new Map();
  let isMoving = false;
  element.addEventListener("pointerdown", ({ pointerId, pointerType, button, shiftKey, clientX }) => {
    if (pointerType === "mouse" && (shiftKey || button)) return;
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
    const apart = Math.abs(after[0] - after[1]);
    if (after.length === 1) view.pan((before[0] - after[0]) / element.clientWidth);
    else if (apart > 10) view.zoom(Math.abs(before[0] - before[1]) / apart, time((after[0] + after[1]) / 2));
  });
  for (const name of /** @type {const} */ (["pointerup", "pointercancel", "pointerleave"]))
    element.addEventListener(name, ({ pointerId }) => {
      held.delete(pointerId);
      element.classList.toggle(PULLED, held.size > 0);
    });
  element.addEventListener("click", ({ shiftKey, target, clientX }) => {
    const item = target.closest("[data-list]")?.dataset;
    if (shiftKey || isMoving) return;
    if (item) openList(/** @type {"alarms" | "notes"} */ (item.list), Number(item.index));
    else press(view, time(clientX));
  });
}

/** Open the list at the alarm or note that was pressed above the curves. @param {"alarms" | "notes"} name @param {number} index */
function openList(name, index) {
  const [list] = listOf(name);
  /** @type {HTMLDetailsElement} */ (list.closest("details")).open = true;
  list.querySelectorAll("button")[index]?.focus();
}

/** The first press sets cursor A, the next B, the third takes both away. @param {View} view @param {number} at */
const press = (view, at) => view.change(view.a === null ? { a: at } : view.b === null ? { b: at } : { a: null, b: null });

/** @param {KeyboardEvent} event @param {Trends} trends @param {(seconds: number) => void} put */
function key(event, { view, at: cursor }, put) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const [from, to] = view.range();
  const at = cursor ?? (from + to) / 2;
  /** @param {number} side */
  const arrow = (side) =>
    event.shiftKey ? view.pan(side * KEY_PAN) : put(Math.min(to, Math.max(from, at + side * KEY_STEP * (to - from))));
  /** @type {Record<string, () => void>} */
  const acts = {
    arrowleft: () => arrow(-1),
    arrowright: () => arrow(1),
    "+": () => view.zoom(0.5, cursor ?? undefined),
    "-": () => view.zoom(2, cursor ?? undefined),
    a: () => view.change({ a: at }),
    b: () => view.change({ b: at }),
    escape: () => view.change({ a: null, b: null }),
    l: () => view.toggleLive(),
  };
  const act = event.key.toLowerCase();
  if (!(act in acts)) return;
  acts[act]();
  event.preventDefault();
}

/** Let a person write a note about a time, where the page has the form. They are the notes of the shift, so the hand-over sheet
 * has them too. `time` gives what it is about: the cursor, else now; `written` is called once it is stored, and `why` gives the
 * text of an error.
 * @param {TrendWords} words @param {() => number} time @param {() => void} written @param {(error: unknown) => string} why */
export function bindNotes(words, time, written, why) {
  const form = document.getElementById("trend-note");
  if (!form) return;
  const { time: about, text, unit } = form.elements;
  const details = /** @type {HTMLDetailsElement} */ (form.closest("details"));
  const [button] = form.querySelectorAll("button");
  const result = document.getElementById("trend-note-result");
  /** A request that is sent again stores its note once. */
  let key = newKey();
  details.addEventListener("toggle", () => {
    if (details.open && !text.value) about.value = toField(time());
  });
  form.oninput = () => {
    key = newKey();
  };
  onSubmit(form, async () => {
    const at = fromField(about.value);
    if (Number.isNaN(at)) {
      result.textContent = words.malformed;
      return;
    }
    button.disabled = true;
    try {
      await writeNote({ time: at, text: text.value, unit: unit.value, key });
      text.value = "";
      key = newKey();
      result.textContent = words.stored;
      written();
    } catch (error) {
      result.textContent = why(error);
    } finally {
      button.disabled = false;
    }
  });
}

const newKey = () => `${Date.now()}-${Math.random()}`;
