// What the server says, put where the page shows it: a Map from field to bound nodes, and nothing is ever
// measured, so a change costs one write. Attributes, each naming a field as GROUP.FIELD:
//   data-live="dry-end/1.actual"          the text
//   data-live-is="dry-end/1.state"        data-is, for CSS; "dry-end/1.inputs@2" takes one place of the text
//   data-live-var="off=dry-end/1.off …"   custom properties of its style, here --off; for bars
//   data-live-step="dry-end/1.off"        data-step, the nearest of 48 steps from 0 to 1; for bars in great number
const values = new Map();
const listeners = new Map();
let bound = new Map();

const UNKNOWN = "–";
const STEPS = 48;
const FIGURE_SPACE = "\u2007";

function textOf(element) {
  const text = document.createTextNode(element.textContent);
  element.replaceChildren(text);
  const empty = element.dataset.empty ?? UNKNOWN;
  const width = Number(element.dataset.width ?? 0);
  return (value) => {
    text.data = (value === "" ? empty : value).padStart(width, FIGURE_SPACE);
  };
}

function stateOf(element, place) {
  return (value) => {
    const state = place === undefined ? value : value.charAt(place);
    if (element.dataset.is !== state) element.dataset.is = state;
  };
}

function variableOf(element, name) {
  const property = `--${name}`;
  return (value) => {
    if (value === "") element.dataset.none = "";
    else {
      if (element.dataset.none !== undefined) delete element.dataset.none;
      element.style.setProperty(property, value);
    }
  };
}

function stepOf(element) {
  let shown = null;
  return (value) => {
    const step = value === "" ? "" : Math.round(value * STEPS);
    if (step === shown) return;
    shown = step;
    element.setAttribute("data-step", step);
  };
}

function add(key, write) {
  const dot = key.indexOf(".");
  const group = key.slice(0, dot);
  const field = key.slice(dot + 1);
  if (!bound.has(group)) bound.set(group, new Map());
  const fields = bound.get(group);
  if (!fields.has(field)) fields.set(field, []);
  fields.get(field).push(write);
  const known = values.get(group)?.[field];
  if (known !== undefined) write(known);
}

const KINDS = {
  "data-live": (element) => add(element.dataset.live, textOf(element)),
  "data-live-is": (element) => {
    const [key, place] = element.dataset.liveIs.split("@");
    add(key, stateOf(element, place));
  },
  "data-live-var": (element) => {
    for (const pair of element.dataset.liveVar.split(" ")) {
      const [name, key] = pair.split("=");
      add(key, variableOf(element, name));
    }
  },
  "data-live-step": (element) => add(element.dataset.liveStep, stepOf(element)),
};

/** Bind every marked element of the document: once, and again after a fragment came in. */
export function rebind() {
  bound = new Map();
  for (const [attribute, bind] of Object.entries(KINDS)) {
    for (const element of document.querySelectorAll(`[${attribute}]`)) bind(element);
  }
}

/** Take in groups of changed fields and show them at once. */
export function show(groups) {
  for (const group in groups) {
    const changed = groups[group];
    const known = values.get(group);
    if (known) Object.assign(known, changed);
    else values.set(group, { ...changed });
    const fields = bound.get(group);
    if (fields) {
      for (const field in changed) {
        const writes = fields.get(field);
        if (writes) for (const write of writes) write(changed[field]);
      }
    }
    const told = listeners.get(group);
    if (told) for (const listener of told) listener(values.get(group), changed);
  }
}

/** A whole snapshot: what it does not hold is not known any more. */
export function replace(groups) {
  values.clear();
  show(groups);
}

/** Call `listener(fields, changed)` whenever something in `group` changes. */
export function listen(group, listener) {
  if (!listeners.has(group)) listeners.set(group, new Set());
  listeners.get(group).add(listener);
  const known = values.get(group);
  if (known) listener(known, known);
  return () => listeners.get(group).delete(listener);
}

/** The present text of GROUP.FIELD, undefined when nothing was ever said of it. */
export function value(key) {
  const dot = key.indexOf(".");
  return values.get(key.slice(0, dot))?.[key.slice(dot + 1)];
}

/** All fields of a group. */
export const fieldsOf = (group) => values.get(group);
