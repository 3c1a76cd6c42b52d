// Shows the values from the server in the page: a Map from field to bound nodes, and no element is ever
// measured, so a change costs one write. When it is written: see pace.js, and for hidden units, visibility.js.
// Attributes, each naming a field as GROUP.FIELD:
//   data-live="dry-end/1.actual"          the text; with data-fresh in a node of its own each time, as what follows a
//                                         name of any length has not moved where both are other words
//   data-live-is="dry-end/1.state"        data-is, for CSS; "dry-end/1.inputs@2" takes one place of the text
//   data-live-bit="dry-end/1.inputs@2"    data-on or data-off as text, by one place of the text
//   data-live-var="fill=dry-end/1.fill …" custom properties of its style, here --fill; for bars
//   data-live-title="dry-end/1.cause"     the text that a pointer at rest shows
//   data-live-href="line_summary.at"        where a link leads; no link while the text is empty
//   data-live-path="line_of/dry-end.spark"  the path of a drawing
//   data-live-quality="line_of/dry-end.quality"  data-quality, for CSS
//   data-live-step="dry-end/1.off"        data-step, the nearest of 144 steps from 0 to 1; for bars in great number
import { soon } from "./pace.js";
import { mayWait } from "./visibility.js";

/** @type {Map<string, Fields>} */
const values = new Map();
/** What changed of each group and is not written yet.
 * @type {Map<string, Fields>} */
let waiting = new Map();
let timer = 0;
/** @type {Map<string, Set<Listener>>} */
const listeners = new Map();
/** @type {Map<string, Map<string, Write[]>>} */
let bound = new Map();
/** @type {HTMLElement[]} */
let elements = [];
/** Whether a text was not as it had been written: a translation or an extension has changed it. */
let isAltered = false;

const UNKNOWN = "–";
const STEPS = 144;
const LATE_MS = 250;
const FIGURE_SPACE = "\u2007";

/** The text that an element has, if it has nothing else: one that was put there anew would be read out again.
 * @param {HTMLElement} element */
function onlyText(element) {
  const { firstChild: first, lastChild: last } = element;
  return first && first === last && first.nodeType === 3 ? /** @type {Text} */ (first) : null;
}

/** @param {HTMLElement} element @returns {Write} */
function textOf(element) {
  let text = onlyText(element) ?? document.createTextNode(element.textContent);
  if (element.firstChild !== text) element.replaceChildren(text);
  const empty = element.dataset.empty ?? UNKNOWN;
  const width = Number(element.dataset.width ?? 0);
  let written = text.data;
  return (value) => {
    if (text.data !== written || element.firstChild !== text || element.lastChild !== text) {
      isAltered = true;
      element.replaceChildren(text);
    }
    written = (value === "" ? empty : value).padStart(width, FIGURE_SPACE);
    if (text.data === written) return;
    if ("fresh" in element.dataset) {
      text = document.createTextNode(written);
      element.replaceChildren(text);
    } else text.data = written;
  };
}

/** @param {HTMLElement} element @param {string} [place] @returns {Write} */
function stateOf(element, place) {
  return (value) => {
    const state = place === undefined ? value : value.charAt(Number(place));
    if (element.dataset.is !== state) element.dataset.is = state;
  };
}

/** @param {HTMLElement} element @param {string} place @returns {Write} */
function bitOf(element, place) {
  const write = textOf(element);
  return (value) => write({ 1: element.dataset.on, 0: element.dataset.off }[value.charAt(Number(place))] ?? UNKNOWN);
}

/** @param {HTMLElement} element @param {string} name @returns {Write} */
function variableOf(element, name) {
  const property = `--${name}`;
  return (value) => {
    if (value === "") {
      if (element.dataset.none === undefined) element.dataset.none = "";
    } else {
      if (element.dataset.none !== undefined) delete element.dataset.none;
      if (element.style.getPropertyValue(property) !== value) element.style.setProperty(property, value);
    }
  };
}

/** @param {HTMLElement} element @returns {Write} */
function titleOf(element) {
  return (value) => {
    if (element.title !== value) element.title = value;
  };
}

/** A link that leads nowhere is none.
 * @param {HTMLElement} element @returns {Write} */
function hrefOf(element) {
  return (value) => {
    if (!value) element.removeAttribute("href");
    else if (element.getAttribute("href") !== value) element.setAttribute("href", value);
  };
}

/** @param {HTMLElement} element @param {string} name @returns {Write} */
function attributeOf(element, name) {
  return (value) => {
    if (element.getAttribute(name) !== value) element.setAttribute(name, value);
  };
}

/** Make a rule for each step, and not a style for each element: a style that many share is computed once. */
function shareSteps() {
  const steps = new CSSStyleSheet();
  for (let step = 0; step <= STEPS; step += 1) steps.insertRule(`[data-step="${step}"] { --at: ${step / STEPS}; }`);
  document.adoptedStyleSheets = [steps];
}

/** @param {HTMLElement} element @returns {Write} */
function stepOf(element) {
  if (document.adoptedStyleSheets.length === 0) shareSteps();
  return (value) => {
    const step = value === "" ? "" : String(Math.round(Number(value) * STEPS));
    if (element.dataset.step !== step) element.dataset.step = step;
  };
}

/** @param {string} key @param {Write} write */
function add(key, write) {
  const dot = key.indexOf(".");
  const group = key.slice(0, dot);
  const field = key.slice(dot + 1);
  const fields = bound.get(group) ?? new Map();
  const writes = fields.get(field) ?? [];
  writes.push(write);
  bound.set(group, fields.set(field, writes));
  const known = values.get(group)?.[field];
  if (known !== undefined) write(/** @type {string} */ (known));
}

/** @type {Record<string, (element: HTMLElement) => void>} */
const KINDS = {
  "data-live": (element) => add(element.dataset.live, textOf(element)),
  "data-live-is": (element) => {
    const [key, place] = element.dataset.liveIs.split("@");
    add(key, stateOf(element, place));
  },
  "data-live-bit": (element) => {
    const [key, place] = element.dataset.liveBit.split("@");
    add(key, bitOf(element, place));
  },
  "data-live-var": (element) => {
    for (const pair of element.dataset.liveVar.split(" ")) {
      const [name, key] = pair.split("=");
      add(key, variableOf(element, name));
    }
  },
  "data-live-title": (element) => add(element.dataset.liveTitle, titleOf(element)),
  "data-live-href": (element) => add(element.dataset.liveHref, hrefOf(element)),
  "data-live-path": (element) => add(element.dataset.livePath, attributeOf(element, "d")),
  "data-live-quality": (element) => add(element.dataset.liveQuality, attributeOf(element, "data-quality")),
  "data-live-step": (element) => add(element.dataset.liveStep, stepOf(element)),
};

/** Bind every marked element of the document: once, and again after a fragment came in. */
export function rebind() {
  bound = new Map();
  elements = [];
  for (const [attribute, bind] of Object.entries(KINDS)) {
    const found = document.querySelectorAll(`[${attribute}]`);
    for (const element of found) bind(element);
    elements.push(...found);
  }
}

/** Whether each element that is bound is in the document, and no other is marked. */
function isComplete() {
  const marked = Object.keys(KINDS).reduce((n, kind) => n + document.querySelectorAll(`[${kind}]`).length, 0);
  return marked === elements.length && elements.every((element) => element.isConnected);
}

/** Show what is known wherever another program, such as a translation or an extension, has changed the page since.
 * Return whether one has changed a text, or replaced what is bound by a copy. */
export function verify() {
  if (isComplete()) for (const [group, known] of values) write(group, known);
  else {
    const before = elements.length;
    rebind();
    // What this page removes itself leaves fewer.
    isAltered ||= elements.length >= before;
    document.dispatchEvent(new CustomEvent("lineside:changed"));
  }
  const wasAltered = isAltered;
  isAltered = false;
  return wasAltered;
}

/** @param {string} group @param {Fields} changed */
function write(group, changed) {
  const fields = bound.get(group);
  let wrote = false;
  for (const field in changed) {
    const writes = fields?.get(field);
    if (!writes) continue;
    wrote = true;
    for (const each of writes) each(/** @type {string} */ (changed[field]));
  }
  return wrote;
}

/** Write pending values to visible nodes; return whether there was anything to write. Half of what comes is the time of
    a reading with the same values, which no node shows. */
export function draw() {
  let wrote = false;
  for (const [group, changed] of waiting) {
    if (mayWait(group)) continue;
    waiting.delete(group);
    wrote = write(group, changed) || wrote;
  }
  if (waiting.size && !timer) timer = setTimeout(drawLate, LATE_MS);
  return wrote;
}

function drawLate() {
  timer = 0;
  soon(draw);
}

/** Write everything that waits. */
export function drawAll() {
  const all = waiting;
  waiting = new Map();
  for (const [group, changed] of all) write(group, changed);
}

/** @param {Groups} groups */
function take(groups) {
  for (const group in groups) {
    const changed = groups[group];
    const known = Object.assign(values.get(group) ?? {}, changed);
    values.set(group, known);
    if (bound.has(group)) {
      const earlier = waiting.get(group);
      if (earlier) Object.assign(earlier, changed);
      else waiting.set(group, { ...changed });
    }
    const subscribers = listeners.get(group);
    if (subscribers) for (const listener of subscribers) listener(known, changed);
  }
}

/** Take in groups of changed fields; they are known at once and shown as soon as the device can.
 * @param {Groups} groups */
export function show(groups) {
  take(groups);
  soon(draw);
}

/** Show a complete snapshot immediately; a field that it lacks becomes unknown.
 * @param {Groups} groups */
export function replace(groups) {
  values.clear();
  waiting.clear();
  take(groups);
  drawAll();
}

/** Call `listener(fields, changed)` whenever something in `group` changes.
 * @param {string} group @param {Listener} listener */
export function listen(group, listener) {
  const subscribers = listeners.get(group) ?? new Set();
  listeners.set(group, subscribers.add(listener));
  const known = values.get(group);
  if (known) listener(known, known);
  return () => subscribers.delete(listener);
}

/** The current text or list of GROUP.FIELD, undefined when it was never received.
 * @template {string} K @param {K} key @returns {Known<K>} */
export function value(key) {
  const dot = key.indexOf(".");
  return /** @type {Known<K>} */ (values.get(key.slice(0, dot))?.[key.slice(dot + 1)]);
}

/** All fields of a group.
 * @param {string} group */
export const fieldsOf = (group) => values.get(group);
