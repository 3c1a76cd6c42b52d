// The setpoint of a unit: the field follows the unit until a user touches it; the number pad; and on
// the setpoints page the tools that fill in many fields at once. Nothing here sends anything.
import { listen, value } from "./bind.js";
import { language, word } from "./words.js";

const DECIMAL_SIGN = new Intl.NumberFormat(language)
  .formatToParts(1.5)
  .find((part) => part.type === "decimal")?.value ?? ".";

/** The number a person typed, comma or point, or NaN. Empty is not zero.
 * @param {string} text */
export function numberOf(text) {
  const plain = text.trim().replace(/[−–]/g, "-").replace(",", ".");
  return /^[+-]?\d+(\.\d+)?$/.test(plain) ? Number(plain) : Number.NaN;
}

// --- the field and its pad ----------------------------------------------------------------------------

/** @param {HTMLInputElement} input */
const isAllSelected = (input) => input.selectionStart === 0 && input.selectionEnd === input.value.length;

/** @type {WeakSet<HTMLInputElement>} */
const following = new WeakSet();

/** Of the page, or of a faceplate that was opened in it. */
function followUnits() {
  for (const input of document.querySelectorAll("[data-follows]")) if (!following.has(input)) followUnit(input);
}

/** @param {HTMLInputElement} input */
function followUnit(input) {
  following.add(input);
  const left = new AbortController();
  const { signal } = left;
  const key = input.dataset.follows;
  // Typed before this script was there.
  if (input.value !== input.defaultValue) input.dataset.touched = "";
  const refresh = () => {
    if (!input.isConnected) return left.abort();
    const text = value(key);
    if (input.dataset.touched !== undefined || text === undefined || text === "–" || text === input.value) return;
    const select = input === document.activeElement && isAllSelected(input);
    input.value = text;
    // The next digit still replaces the unit's value.
    if (select) input.select();
  };
  signal.addEventListener("abort", listen(key.slice(0, key.indexOf(".")), refresh));
  input.addEventListener("input", () => {
    input.dataset.touched = "";
    // A message about the former number does not apply to this one.
    const place = document.getElementById(input.getAttribute("aria-describedby") ?? "");
    place?.replaceChildren();
  });
  // A value half typed is not selected again: the next digit is appended.
  input.addEventListener("focus", () => input.dataset.touched === undefined && input.select());
  const forget = () => {
    delete input.dataset.touched;
    refresh();
  };
  // What was typed stays until it is set.
  document.addEventListener("lineside:taken", ({ detail }) => detail === input.form && forget(), { signal });
  // A page that was just loaded may have been typed into; one that the browser kept is as it was left.
  addEventListener("pageshow", ({ persisted }) => persisted && forget(), { signal });
}

/** @param {HTMLInputElement} input @param {string} key */
function press(input, key) {
  const untouched = input.dataset.follows !== undefined && input.dataset.touched === undefined;
  const fresh = untouched || isAllSelected(input);
  if (key === "erase") input.value = fresh ? "" : input.value.slice(0, -1);
  else if (key === "-") input.value = input.value.startsWith("-") ? input.value.slice(1) : `-${input.value}`;
  else if (key.length === 1 && (input.maxLength < 0 || (fresh ? "" : input.value).length < input.maxLength))
    input.value = (fresh ? "" : input.value) + key;
  input.setSelectionRange(input.value.length, input.value.length);
  input.dispatchEvent(new Event("input", { bubbles: true }));
}

/** A step changes what is typed where something is: only of the unit's own setpoint is it sent at once.
 * @param {MouseEvent} event */
function stepTyped(event) {
  const button = /** @type {Element} */ (event.target).closest(".nudges button");
  const input = /** @type {HTMLInputElement | null} */ (button?.closest("form")?.querySelector("[data-follows][data-touched]"));
  if (!button || !input) return;
  event.stopPropagation();
  const [by, typed] = [button.textContent.trim(), numberOf(input.value)];
  const decimals = Math.max(...[by, input.value].map((text) => text.split(/[.,]/)[1]?.length ?? 0));
  if (Number.isNaN(typed)) return input.focus();
  input.value = Math.max(0, typed + numberOf(by)).toFixed(decimals).replace(".", DECIMAL_SIGN);
  input.dispatchEvent(new Event("input", { bubbles: true }));
}

// --- many at once ----------------------------------------------------------------------------------------

/** @type {Record<string, (present: number, by: number) => number>} */
const TOOLS = {
  scale: (present, by) => (present * by) / 100,
  offset: (present, by) => present + by,
};

/** A setpoint, as [raw, decimals], that a tool has changed, as text; null where the setpoint is not known.
 * @param {string} tool @param {Partial<Setpoint>} [setpoint] */
export function changed(tool, [raw, decimals] = [], by = 0) {
  if (typeof raw !== "number" || typeof decimals !== "number") return null;
  return TOOLS[tool](raw / 10 ** decimals, by).toFixed(decimals).replace(".", DECIMAL_SIGN);
}

/** What a tool does with a text: percent with a sign are a change, so ``+5`` is 105 % of each unit's own setpoint.
 * @param {string} tool @param {string} text */
export const amountOf = (tool, text) =>
  numberOf(text) + (tool === "scale" && /^\s*[+\-−–]/.test(text) ? 100 : 0);

/** Online and not in LOCAL; see the row in templates/setpoints/page.html.
 * @param {Element} element */
const canBeSet = (element) => !element.closest("[inert]") && element.checkVisibility();

/** The fields of selected units that can be set now, each with the setpoint of its unit.
 * @param {HTMLElement} form */
function selected(form) {
  const rows = Array.from(form.querySelectorAll("tr[data-unit]:has([data-tick]:checked) [data-new]"));
  const fields = /** @type {HTMLInputElement[]} */ (rows).filter((field) => field.dataset.new && canBeSet(field));
  return fields.map((field) => ({ field, setpoint: value(`${field.dataset.new}.setpoint`) }));
}

/** Say why nothing was filled in; an empty text clears the place.
 * @param {HTMLElement} form @param {string} text */
function refuse(form, text) {
  const fault = document.createElement("p");
  fault.className = "field__error";
  fault.textContent = text;
  form.querySelector("[role=status]").replaceChildren(...(text ? [fault] : []));
}

/** Mark the field that the server refused, until its text is another one: then the reason is over, too. */
function markRefused() {
  for (const reason of document.querySelectorAll("[data-setpoints] [data-refuses]")) {
    const field = /** @type {HTMLInputElement} */ (reason.closest("form")?.elements.namedItem(reason.dataset.refuses ?? ""));
    reason.dataset.refused ??= field.value;
    const isOver = field.value !== reason.dataset.refused;
    if (isOver) reason.parentElement?.replaceChildren();
    field.setAttribute("aria-invalid", String(!isOver));
  }
}

/** @param {HTMLElement} form */
function enter(form) {
  const source = /** @type {HTMLInputElement} */ (form.querySelector("[data-together]"));
  const tool = source.dataset.together ?? "";
  const by = amountOf(tool, source.value);
  const fields = selected(form);
  source.setAttribute("aria-invalid", Number.isNaN(by) ? "true" : "false");
  if (Number.isNaN(by)) {
    refuse(form, source.value.trim() ? word("noNumber", source.value) : word("empty"));
    return source.focus();
  }
  refuse(form, fields.length ? "" : word("noneSelected"));
  for (const { field, setpoint } of fields) {
    const text = tool === "value" ? source.value.trim() : changed(tool, setpoint, by);
    if (text !== null) field.value = text;
  }
}

/** Change what is entered, or else the setpoint, by percent of each unit's own setpoint: twice +5 % is +10 %.
 * @param {HTMLElement} form @param {number} percent */
function step(form, percent) {
  const fields = selected(form);
  refuse(form, fields.length ? "" : word("noneSelected"));
  for (const { field, setpoint } of fields) {
    const present = numberOf(changed("offset", setpoint, 0) ?? "");
    if (Number.isNaN(present)) continue;
    const entered = numberOf(field.value);
    const more = (Number.isNaN(entered) ? 0 : entered - present) + (present * percent) / 100;
    field.value = changed("offset", setpoint, more) ?? "";
  }
}

// --- what the tray of this person holds, wherever its units are shown ------------------------------------

function markTray() {
  const held = document.querySelector("#tray [data-tray-values]")?.dataset.trayValues ?? "[]";
  /** @type {Record<string, string>} */
  const texts = Object.assign({}, ...JSON.parse(held));
  for (const mark of document.querySelectorAll("[data-in-tray]")) {
    const text = texts[mark.dataset.inTray ?? ""] ?? "";
    if (mark.textContent !== text) mark.textContent = text;
  }
}

// --- draw, as it becomes by what is typed ---------------------------------------------------------------

/** What is entered for each unit, as a number; NaN for nothing. In one search: one for each of 255 units holds the page up.
 * @returns {Map<string, number>} */
function enteredByUnit() {
  const entered = new Map();
  const fields = document.querySelectorAll('[data-new], [data-follows$=".commanded"][data-touched]');
  for (const field of /** @type {NodeListOf<HTMLInputElement>} */ (fields))
    entered.set(field.dataset.new ?? field.dataset.follows?.replace(/\.commanded$/, ""), numberOf(field.value));
  return entered;
}

/** The present setpoint of a unit; 0 while it stands, NaN while it is not known.
 * @param {string} unit */
function presentOf(unit) {
  if (numberOf((value(`${unit}.actual`) ?? "").trim()) === 0) return 0;
  return numberOf(changed("offset", value(`${unit}.setpoint`)) ?? "");
}

/** The draw in tenths of a percent, rounded as the server rounds it; NaN for none.
 * @param {number} before @param {number} section */
export function drawTenths(before, section) {
  if (!(before > 0 && section > 0)) return Number.NaN;
  const tenths = (1000 * (section - before)) / before;
  return Math.sign(tenths) * Math.round(Math.abs(tenths));
}

/** @param {HTMLElement} place @param {Map<string, number>} byUnit */
function showDraw(place, byUnit) {
  const units = (place.dataset.draw ?? "").split(" ");
  const entered = units.map((unit) => byUnit.get(unit) ?? Number.NaN);
  const [before, section] = units.map((unit, at) => (Number.isNaN(entered[at]) ? presentOf(unit) : entered[at]));
  // Of values that are old there is none.
  const isOld = units.some((unit) => !["online", undefined].includes(value(`${unit}.link`)));
  const tenths = isOld || entered.every(Number.isNaN) ? Number.NaN : drawTenths(before, section);
  const [low, high] = (place.dataset.band ?? "-Infinity Infinity").split(" ").map(Number);
  const sign = tenths > 0 ? "+" : tenths < 0 ? "−" : "±";
  const text = `${sign}${(Math.abs(tenths) / 10).toFixed(1).replace(".", DECIMAL_SIGN)} %`;
  const shown = place.querySelector(".draw-typed__new");
  const known = Number.isNaN(tenths) ? "" : text;
  if (shown && shown.textContent !== known) shown.textContent = known;
  place.toggleAttribute("data-out", tenths / 10 < low || tenths / 10 > high);
}

function showDraws() {
  areDue = false;
  const entered = enteredByUnit();
  for (const place of document.querySelectorAll("[data-draw]")) showDraw(place, entered);
}

let areDue = false;

/** Once for all units that a message changes. */
function showDrawsSoon() {
  if (!areDue) queueMicrotask(showDraws);
  areDue = true;
}

/** @type {Set<string>} */
const drawnUnits = new Set();

/** Of the page, or of a faceplate that was opened in it. */
function listenForDraws() {
  const places = /** @type {HTMLElement[]} */ ([...document.querySelectorAll("[data-draw]")]);
  for (const unit of places.flatMap(({ dataset }) => (dataset.draw ?? "").split(" "))) {
    if (drawnUnits.has(unit)) continue;
    drawnUnits.add(unit);
    listen(unit, (_, changed) => ["setpoint", "actual", "link"].some((field) => field in changed) && showDrawsSoon());
  }
}

function followDraws() {
  listenForDraws();
  document.addEventListener("input", showDraws);
  for (const event of ["lineside:done", "lineside:taken"])
    document.addEventListener(event, () => setTimeout(showDraws));
}

/** @param {HTMLElement} form @param {HTMLElement} button */
function together(form, { dataset: { togetherDo: what, by = "" } }) {
  if (what === "enter") return enter(form);
  if (what === "step") return step(form, numberOf(by));
  if (what === "clear") return clear(form);
  for (const tick of form.querySelectorAll("[data-tick]")) tick.checked = canBeSet(tick);
}

/** @param {HTMLElement} form */
function clear(form) {
  for (const tick of form.querySelectorAll("[data-tick]")) tick.checked = false;
  for (const field of form.querySelectorAll("[data-new]")) field.value = "";
}

/** A completed change is no draft: the next change starts with empty fields. */
function forgetDone() {
  document.addEventListener("lineside:taken", ({ detail: form }) => {
    if (form?.matches("[data-setpoints]")) clear(form);
  });
}

/** The field that a key of a pad types into. @param {HTMLElement} key */
const fieldOf = (key) =>
  /** @type {HTMLInputElement} */ (document.getElementById(key.closest("[data-pad-for]")?.dataset.padFor ?? ""));

export function start() {
  forgetDone();
  followUnits();
  followDraws();
  markTray();
  for (const follows of [followUnits, markTray, listenForDraws, showDraws, markRefused]) document.addEventListener("lineside:changed", follows);
  document.addEventListener("input", markRefused);
  document.addEventListener("click", stepTyped, { capture: true });
  document.addEventListener("click", (event) => {
    const button = event.target.closest("[data-pad], [data-use], [data-together-do]");
    if (!button) return;
    const { pad, togetherDo } = button.dataset;
    if (pad) press(fieldOf(button), pad);
    else if (togetherDo) {
      const form = /** @type {HTMLFormElement} */ (button.closest("form"));
      together(form, button);
      // What a button enters or clears is kept as what is typed (drafts.js), and its draw is shown.
      form.querySelector("[data-together]")?.dispatchEvent(new Event("input", { bubbles: true }));
    }
    else {
      const { ofField } = button.dataset;
      const input = /** @type {HTMLInputElement} */ ((button.closest("form, td") ?? document).querySelector(
        ofField ? `[name="${ofField}"]` : "input:not([type=hidden], [type=checkbox])",
      ));
      input.value = button.dataset.use ?? "";
      input.dispatchEvent(new Event("input", { bubbles: true }));
      input.focus();
    }
  });
  document.addEventListener("change", ({ target }) => {
    const tool = /** @type {HTMLSelectElement | null} */ (target.closest("[data-together-tool]"));
    const source = tool?.parentElement?.querySelector("[data-together]");
    if (tool && source) source.setAttribute("data-together", tool.value);
  });
  // Scrolling never changes a value.
  document.addEventListener(
    "wheel",
    (event) => event.target.matches?.("input[type=number]") && event.target.blur(),
    { passive: true },
  );
}
