// What was typed survives a refusal, a lost server and another page: kept in this tab for a shift, put back as a draft
// with its time, and sent only by the person. A form whose fields were sent, cleared or discarded has no draft.
import * as clock from "./clock.js";
import { timeOfDay } from "./live.js";
import { word } from "./words.js";

/** `isSent`: a command with these values was sent, and its result is not known.
 * @typedef {{ at: number, fields: Record<string, string>, isSent?: boolean }} Draft */
const STORED = "lineside-drafts";
const SENT = "lineside-draft-sent";
const KEPT_S = 8 * 3600;
const MAX_DRAFTS = 30;
const MAX_LENGTH = 4000;
const STAMP = /[?&]clicked_at=[\d.]+$/;
const FIELDS =
  "input:is([type=text], [type=number], :not([type])), input.input--number, textarea, select";
const { account } = document.body.dataset;

/** @returns {Record<string, Draft>} */
function read() {
  try {
    return JSON.parse(sessionStorage.getItem(STORED) ?? "{}");
  } catch {
    return {};
  }
}

/** @param {Record<string, Draft>} drafts */
function write(drafts) {
  const newest = Object.entries(drafts)
    .filter(([, { at }]) => clock.now() - at < KEPT_S)
    .sort(([, one], [, other]) => other.at - one.at)
    .slice(0, MAX_DRAFTS);
  try {
    sessionStorage.setItem(STORED, JSON.stringify(Object.fromEntries(newest)));
  } catch {
    // A browser that keeps nothing has no drafts.
  }
}

/** The address of a form without the moment of the press (review.js), and what it is about: a bus, a parameter of many
 * units, a note that is corrected, the alarm or the unit whose page led to a note.
 * @param {HTMLFormElement} form */
const keyOf = (form) => {
  const address = (form.getAttribute("hx-post") ?? form.action).replace(STAMP, "");
  /** @type {NodeListOf<HTMLInputElement>} */
  const about = form.querySelectorAll("input[type=hidden]:is([name=bus], [name=number], [name=corrects])");
  return [account, location.pathname, address, ...Array.from(about, ({ value }) => value), form.dataset.about].join(" ").trim();
};

/** A form that only filters, or is part of a review, has none; nor has a field that is not sent or is a secret.
 * @param {HTMLFormElement} form */
const canKeep = (form) =>
  Boolean(account) && !form.closest("dialog, [data-review-place]") && (form.hasAttribute("hx-post") || form.method === "post");

/** @param {HTMLFormElement} form */
const fieldsOf = (form) =>
  /** @type {HTMLInputElement[]} */ ([...form.querySelectorAll(FIELDS)]).filter(
    ({ name, type }) => name && type !== "password" && type !== "hidden",
  );

/** A setpoint follows its unit until a person types.
 * @param {HTMLInputElement} field */
const isFollowing = ({ dataset }) => dataset.follows !== undefined && dataset.touched === undefined;

/** @param {HTMLInputElement | HTMLSelectElement} field */
const untouched = (field) =>
  field instanceof HTMLSelectElement
    ? ([...field.options].find(({ defaultSelected }) => defaultSelected) ?? field.options[0])?.value
    : field.defaultValue;

/** @param {HTMLFormElement} form */
function keep(form) {
  const changed = fieldsOf(form).filter((field) => !isFollowing(field) && field.value !== untouched(field));
  const fields = Object.fromEntries(changed.map(({ name, value }) => [name, value.slice(0, MAX_LENGTH)]));
  if (!changed.length) return forget(form);
  write({ ...read(), [keyOf(form)]: { at: clock.now(), fields } });
}

/** @param {string} key */
function drop(key) {
  const { [key]: _, ...others } = read();
  write(others);
}

/** @param {HTMLFormElement} form */
function forget(form) {
  drop(keyOf(form));
  form.querySelector("[data-draft]")?.remove();
}

/** @param {HTMLFormElement} form */
function putBack(form) {
  const draft = read()[keyOf(form)];
  if (!draft || clock.now() - draft.at > KEPT_S) return;
  const found = fieldsOf(form).filter(({ name, value }) => name in draft.fields && value !== draft.fields[name]);
  for (const field of found) {
    field.value = draft.fields[field.name];
    if (field.dataset.follows !== undefined) field.dataset.touched = "";
  }
  // Where the page has a place for results, it moves nothing.
  if (found.length) (form.querySelector(".setpoints__act > .change-report") ?? form).prepend(note(form, found, draft));
}

/** @type {WeakSet<HTMLFormElement>} */
const known = new WeakSet();

/** Also in forms that came later: a faceplate, a table drawn again. */
function putBackNew() {
  for (const form of document.forms) {
    if (known.has(form) || !canKeep(form)) continue;
    known.add(form);
    putBack(form);
  }
}

/** @param {HTMLFormElement} form @param {HTMLInputElement[]} found @param {Draft} draft */
function note(form, found, { at, isSent }) {
  const before = found.map((field) => /** @type {const} */ ([field, untouched(field) ?? ""]));
  const line = document.createElement("p");
  line.className = "draft";
  line.dataset.draft = "";
  const button = document.createElement("button");
  button.type = "button";
  // No other button is taken for it once it is gone (focus.js).
  button.name = "discard";
  button.className = "button";
  button.textContent = word("draftDiscard");
  button.addEventListener("click", () => {
    for (const [field, value] of before) {
      field.value = value;
      delete field.dataset.touched;
    }
    forget(form);
    document.dispatchEvent(new CustomEvent("lineside:changed"));
  });
  const text = document.createElement("span");
  text.textContent = word(isSent ? "draftSent" : "draftOf", timeOfDay(at));
  line.append(text, button);
  return line;
}

/** @param {HTMLFormElement} form */
function noteSent(form) {
  const drafts = read();
  const draft = drafts[keyOf(form)];
  if (draft) write({ ...drafts, [keyOf(form)]: { ...draft, isSent: true } });
}

/** What a page sent as it was left: its draft ends, unless this page is the refusal. */
function settle() {
  const sent = sessionStorage.getItem(SENT);
  if (!sent) return;
  sessionStorage.removeItem(SENT);
  if (!document.querySelector("[data-code]")) drop(sent);
}

export function start() {
  if (!account) return;
  settle();
  putBackNew();
  // What was just set is no draft any more.
  document.addEventListener("lineside:changed", () => setTimeout(putBackNew));
  document.addEventListener("input", ({ target }) => {
    const { form } = /** @type {HTMLInputElement} */ (target);
    if (form && canKeep(form)) keep(form);
  });
  document.addEventListener("submit", (event) => {
    const form = event.target;
    if (!canKeep(form)) return;
    if (!form.hasAttribute("hx-post") && !event.defaultPrevented) sessionStorage.setItem(SENT, keyOf(form));
  });
  document.addEventListener("lineside:unknown", ({ detail: form }) => form && canKeep(form) && noteSent(form));
  document.addEventListener("lineside:taken", ({ detail: form }) => form && canKeep(form) && forget(form));
}
