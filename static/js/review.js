// A review, in a part of the page or in the dialog: focus rests on Cancel, Enter does not execute, it lapses after
// 30 s, when the value has moved or the unit takes nothing from here any more, and nothing leaves while the server does
// not respond. The result of one is a strip where the review names a place, with nothing to close.
import { fieldsOf, listen, rebind, value } from "./bind.js";
import * as clock from "./clock.js";
import { reveal } from "./element.js";
import { giveBack } from "./focus.js";
import { isLive, timeOfDay } from "./live.js";
import { word } from "./words.js";

const LAPSE_MS = 30_000;
const dialog = document.getElementById("review");
const PLACE = "[data-review-place]";
/** Where a review is open, or was last: one at a time. */
let content = document.getElementById("review-body");
/** The form of the page whose fields are under review; null for a review of something else.
 * @type {HTMLFormElement | null} */
let reviewed = null;
/** @type {(() => void)[]} */
let endings = [];
/** What was pressed last before the first message of the server, and when.
 * @type {{ source: HTMLElement, submitter: HTMLElement | null, at: number } | null} */
let early = null;
/** A press is not carried out later than so. */
const EARLY_MS = 2000;
/** How long ago what is being requested was pressed. */
let agoMs = 0;

/** @param {HTMLElement} place @param {HTMLElement} source */
function opened(place, source) {
  close();
  // What a review itself requests shows in the place of it.
  if (source.isConnected && !place.contains(source))
    reviewed = source.matches("form") ? /** @type {HTMLFormElement} */ (source) : null;
  if (content !== place) content.replaceChildren();
  content = place;
  if (!content.firstElementChild) return;
  if (!content.querySelector("[data-review-cancel]")) content.append(closer());
  // How a former one ended is no word about this one; what was added to the tray may be sent by it.
  for (const words of document.querySelectorAll("[role=status] > :is([data-review-end], [data-added])"))
    words.remove();
  show();
  const form = content.querySelector("[data-review]");
  if (form) watch(form);
}

const isModal = () => dialog.contains(content);

function show() {
  if (isModal() && !dialog.open) dialog.showModal();
  dialog.classList.toggle("dialog--wide", Boolean(content.querySelector(".review--wide")));
  // Show the head first; the button with the focus is visible anyway.
  const cancel = /** @type {HTMLElement | null} */ (content.querySelector("[data-review-cancel]"));
  cancel?.focus({ preventScroll: true });
  if (isModal()) dialog.scrollTop = 0;
  else for (const part of [content, cancel]) part?.scrollIntoView({ block: "nearest" });
}

/** Where the result of a review goes; null where it replaces the review.
 * @param {HTMLElement} form */
const stripOf = (form) => document.querySelector(`${form.getAttribute("hx-target")}:not(${PLACE})`);

/** For a response without a button, for example a refusal by the server. */
function closer() {
  const box = document.createElement("div");
  box.className = "dialog__body";
  const button = document.createElement("button");
  button.type = "button";
  button.className = "button";
  button.dataset.reviewCancel = "";
  button.textContent = word("close");
  box.append(button);
  return box;
}

/** @param {HTMLElement} form */
function watch(form) {
  const timer = setTimeout(() => end(form, word("lapsed")), LAPSE_MS);
  const bar = form.querySelector("[data-lapse]");
  bar?.animate([{ scale: "1 1" }, { scale: "0 1" }], { duration: LAPSE_MS, fill: "forwards" });
  endings.push(() => clearTimeout(timer));
  for (const part of [form, ...form.querySelectorAll("[data-watch]")]) watchUnit(form, part);
  const drawn = /** @type {HTMLElement | null} */ (form.querySelector("[data-review-units]"));
  if (drawn) {
    import("./review-zero.js").then(({ redrawWith }) => {
      if (drawn.isConnected && form.dataset.pending === undefined) endings.push(redrawWith(drawn, content));
    });
  }
}

/** One unit: the form names it; several: a row each, with the name.
 * @param {HTMLElement} form @param {HTMLElement} part */
function watchUnit(form, part) {
  const { of: unit, watch: key } = part.dataset;
  const group = unit ?? key?.slice(0, key.indexOf("."));
  if (!group) return;
  // A read-only bus takes a change to zero all the same.
  const blocked = fieldsOf(group)?.blocked;
  endings.push(
    listen(group, (fields) => {
      const reason = whyOver(part, fields.blocked === blocked ? { ...fields, blocked: "" } : fields);
      if (reason) end(form, reason);
    }),
  );
}

/** Why a review no longer holds for the unit that a part of it names; empty while it does. A row is watched only where
 * its unit takes part.
 * @param {HTMLElement} part @param {Fields} fields */
export function whyOver({ dataset: { of: unit, watch: key, was, name, on, off, signals } }, fields) {
  const [field, place] = key?.split("@") ?? [];
  const all = field ? value(field) : undefined;
  const bit = place ? /** @type {string | undefined} */ (all)?.charAt(Number(place)) : "";
  const present = place ? { 1: on, 0: off }[bit ?? ""] : all;
  const moved = present !== undefined && present !== was ? word("moved", present || "–") : "";
  const reason =
    (unit || name ? whyNot(fields) : "") || (signals && whyOtherEffect(signals, fields)) || moved;
  return name && reason ? `${name}: ${reason}` : reason;
}

/** Run and E-stop, as a review was drawn with them. @param {Fields} fields */
export const signalsOf = ({ inputs }) => /** @type {string | undefined} */ (inputs)?.slice(0, 2) ?? "";

/** Why a setpoint has another effect than the review says, which was drawn with these signals (Run, E-stop).
 * @param {string} signals @param {Fields} fields */
function whyOtherEffect(signals, fields) {
  const inputs = signalsOf(fields);
  if (!inputs || inputs === signals) return "";
  if (inputs[1] === signals[1]) return word("runMoved");
  return word(inputs[1] === "1" ? "estopCame" : "estopWent");
}

/** Why a unit takes nothing from here any more; empty while it does. One that is late has not stopped responding.
 * @param {Fields} fields */
export function whyNot({ link, mode, blocked }) {
  if (link !== "online" && link !== "stale") return word("stoppedResponding");
  if (mode !== "remote") return word("leftRemote");
  return blocked ? word("wasBlocked", blocked) : "";
}

/** A part of the page that is fetched as the page is opened or on its way, and not by a press.
 * @param {Element} source */
const isAutomatic = (source) => source.hasAttribute("hx-trigger");

/** The review is over without a command: the reason stays, in its strip or in the dialog without the button.
 * @param {HTMLElement} form @param {string} reason */
function end(form, reason) {
  close();
  if (form.dataset.pending !== undefined || form.dataset.ended !== undefined) return;
  form.dataset.ended = "";
  const strip = stripOf(form);
  const text = `${timeOfDay(clock.now())} · ${reason}`;
  if (strip) {
    explain(strip, text, form.dataset.unanswered === undefined ? "unsent" : "");
    return dismiss();
  }
  const words = form.querySelector("[data-review-end]");
  words.textContent = text;
  words.hidden = false;
  form.querySelector("[data-review-act]")?.remove();
  form.querySelector("[data-lapse]")?.parentElement?.remove();
  const cancel = /** @type {HTMLElement} */ (form.querySelector("[data-review-cancel]"));
  cancel.textContent = word("close");
  cancel.focus();
}

function close() {
  for (const ending of endings) ending();
  endings = [];
}

/** The outcome of the command, "ended" where the review ended before one, empty where a person left it. */
function outcome() {
  const form = content.querySelector("[data-review]:not([data-ended])");
  const strip = form?.dataset.pending === undefined ? null : stripOf(form);
  const done = (strip ?? content).querySelector("[data-review-done]");
  if (strip && !done) return "bad";
  if (done) return done.dataset.reviewDone;
  if (content.querySelector("[data-unanswered]")) return "unknown";
  return content.querySelector("[data-ended]") ? "ended" : "";
}

function dismiss(detail = outcome()) {
  close();
  if (dialog.open) dialog.close();
  // A result in the place of the form: what was typed was sent.
  if (detail === "good" || (detail === "unknown" && !reviewed?.isConnected)) taken(reviewed);
  else if (detail === "unknown")
    document.dispatchEvent(new CustomEvent("lineside:unknown", { detail: reviewed }));
  reviewed = null;
  document.dispatchEvent(new CustomEvent("lineside:done", { detail }));
  content.replaceChildren();
  giveBack(true);
}

/** The button names the line that it sets to zero, or their number.
 * @param {HTMLElement} lines */
export function nameTicked(lines) {
  const act = /** @type {HTMLButtonElement | null} */ (
    content.querySelector("[data-review]:not([data-pending]) [data-review-act]")
  );
  if (!act) return;
  const ticked = /** @type {NodeListOf<HTMLElement>} */ (lines.querySelectorAll("input:checked"));
  act.disabled = ticked.length === 0;
  act.textContent =
    (ticked.length === 1 && ticked[0]?.dataset.verb) ||
    JSON.parse(lines.dataset.verbs ?? "[]")[ticked.length];
}

/** Lock the form while its command is in progress, and show the progress.
 * @param {HTMLElement} form */
function lock(form) {
  close();
  form.dataset.pending = "";
  const progress = form.querySelector("[data-review-progress]");
  if (progress) progress.hidden = false;
  for (const button of form.querySelectorAll("button")) button.disabled = true;
  form.querySelector("[data-lapse]")?.parentElement?.remove();
  // What undo offers was the value before another command.
  for (const undo of document.querySelectorAll("[data-undo]")) undo.dataset.over = "";
}

/** Show that the request got no response, so the outcome is unknown.
 * @param {HTMLElement} form */
function unanswered(form) {
  delete form.dataset.pending;
  form.dataset.unanswered = "";
  for (const button of form.querySelectorAll("button")) button.disabled = false;
  end(form, word("outcomeUnknown"));
}

/** What was typed in a form is set, or in the change tray: it is no draft. What was typed elsewhere stays.
 * @param {HTMLFormElement | null} form */
const taken = (form) => document.dispatchEvent(new CustomEvent("lineside:taken", { detail: form }));

/** What was typed is in the change tray: its review is over.
 * @param {HTMLElement} source */
function added(source) {
  taken(source.closest("form"));
  if (content.contains(source)) dismiss("good");
}

/** Show on the button that was pressed that its request is on its way, until there is a response.
 * @param {Element} source @param {boolean} isBusy */
function mark(source, isBusy) {
  const pressed = document.activeElement?.closest("button, a");
  const button = source.matches("form") ? (pressed && source.contains(pressed) ? pressed : null) : source;
  if (!isBusy)
    for (const busy of document.querySelectorAll(":is(.button, a)[aria-busy]"))
      busy.removeAttribute("aria-busy");
  else if (button?.matches(".button")) button.setAttribute("aria-busy", "true");
}

/** Take away why there is no review of a parameter, which lies over the next row: once its field has changed, by
 * Escape, and by a press elsewhere. What is typed stays. @param {Event} event */
function forget(event) {
  if (event instanceof KeyboardEvent && event.key !== "Escape") return;
  if (event.type === "input") document.querySelector("[data-review-end=unsent]")?.remove();
  const cell = /** @type {Element} */ (event.target).closest(".parameters__new");
  // Beside a field of many it keeps its place, so that no field below moves.
  const beside = /** @type {Element} */ (event.target).closest("td")?.querySelector(".batch-error");
  if (beside && event.type === "input") {
    beside.setAttribute("data-over", "");
    beside.parentElement?.querySelector("input")?.removeAttribute("aria-invalid");
  }
  for (const words of document.querySelectorAll(".parameters__error:has(> *)")) {
    if (event.type !== "keydown" && (words.parentElement === cell) === (event.type === "click")) continue;
    if (words.contains(document.activeElement)) words.parentElement?.querySelector("input")?.focus();
    words.replaceChildren();
  }
}

/** @param {HTMLElement | null} strip @param {string} reason @param {string} [kind] "unsent" is over once a field changes */
function explain(strip, reason, kind = "") {
  const words = document.createElement("p");
  words.className = "field__error";
  words.dataset.reviewEnd = kind;
  words.textContent = reason;
  // A part of a table is no place for words; its status is.
  const place = strip?.matches("[role=status]") ? strip : strip?.querySelector("[role=status]");
  place?.replaceChildren(words);
  reveal(place);
}

/** End the review when the connection is lost, and state that where it was, in the dialog once the server is back: nothing
 * was sent, or of a pending command that its outcome is unknown. What is typed in a field stays. */
function lost() {
  early = null;
  const form = content.querySelector("[data-review]");
  if (!form) {
    if (content.firstElementChild) dismiss();
    return;
  }
  if (form.dataset.pending === undefined) end(form, word("reviewLost"));
  else unanswered(form);
  if (dialog.open) dialog.close();
}

/** Carry out what was pressed before the first message, as of the moment of the press. */
function repeatEarly() {
  const { source, submitter: by, at } = early ?? {};
  early = null;
  if (!source?.isConnected || at === undefined || performance.now() - at > EARLY_MS) return;
  agoMs = performance.now() - at;
  if (source.matches("form"))
    /** @type {HTMLFormElement} */ (source).requestSubmit(by?.isConnected ? by : null);
  else source.click();
  agoMs = 0;
}

/** A form that the browser sends: not while the server does not respond, and with the moment of the press,
 * so that one that is held up on the way is refused (app/core/web/arrival.py).
 * @param {On<SubmitEvent, HTMLFormElement>} event */
function submitted(event) {
  const form = event.target;
  if (event.defaultPrevented || !document.body.dataset.liveUrl) return;
  if (document.body.dataset.link === "lost") return event.preventDefault();
  if (form.method !== "post") return;
  // A page that was just opened has no server time yet; its server has only just responded.
  if (!isLive()) return;
  const url = new URL(form.action);
  url.searchParams.set("clicked_at", clock.now().toFixed(3));
  form.action = url.href;
}

/** An identity for a command that has no review: what is posted twice is carried out once. */
const newId = () =>
  Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join(
    "",
  );

export function start() {
  if (!dialog) return;
  document.addEventListener("click", (event) => {
    if (event.target.closest("[data-review-cancel]")) dismiss();
    event.target.closest("[data-result-close]")?.closest(".tray")?.replaceChildren();
  });
  dialog.addEventListener("cancel", (event) => {
    if (content.querySelector("[data-pending]")) event.preventDefault();
    else dismiss();
  });
  document.addEventListener("keydown", (event) => {
    if (!content.contains(event.target)) return;
    // Enter executes nothing but the button that has the focus.
    if (event.key === "Enter" && event.target.matches("input, select")) event.preventDefault();
    if (event.key !== "Escape" || isModal() || content.querySelector("[data-pending]")) return;
    event.preventDefault();
    dismiss();
  });
  dialog.addEventListener("input", (event) => {
    const typed = event.target.closest("[data-typed]");
    if (typed)
      content.querySelector("[data-review-act]").disabled = typed.value.trim() !== typed.dataset.typed;
    const lines = event.target.closest("[data-verbs]");
    if (lines) nameTicked(lines);
  });
  for (const kind of ["input", "click", "keydown"]) document.addEventListener(kind, forget);
  document.addEventListener("lineside:lost", lost);
  document.addEventListener("lineside:found", () => {
    if (isModal() && !dialog.open && content.querySelector("[data-ended]")) show();
    repeatEarly();
  });
  document.addEventListener("lineside:idle", () => {
    if (!content.querySelector("[data-pending]")) dismiss();
  });

  document.addEventListener("submit", submitted);
  document.addEventListener("htmx:config:request", (event) => {
    const { ctx } = event.detail;
    ctx.request.headers["Lineside-Clicked-At"] = (clock.now() - agoMs / 1000).toFixed(3);
    if (ctx.sourceElement.matches("[data-once]")) ctx.request.body.set("id", newId());
  });
  document.addEventListener("htmx:before:request", (event) => {
    const { request, sourceElement: source } = event.detail.ctx;
    // A part of the page may come before the first message of the server; what was pressed is carried out then.
    if (!isLive() && !(request.method === "GET" && isAutomatic(source))) {
      if (document.body.dataset.link !== "lost")
        early = { source, submitter: request.submitter ?? null, at: performance.now() };
      return event.preventDefault();
    }
    if (!isAutomatic(source)) mark(source, true);
    if (source.matches("[data-review]")) lock(source);
  });
  document.addEventListener("htmx:finally:request", ({ detail }) => mark(detail.ctx.sourceElement, false));
  document.addEventListener("htmx:after:swap", (event) => {
    rebind();
    document.dispatchEvent(new CustomEvent("lineside:changed"));
    const { target: named, sourceElement: source } = event.detail.ctx;
    const target = typeof named === "string" ? document.querySelector(named) : named;
    if (target?.matches(PLACE)) opened(target, source);
    else if (source.matches("[data-review]")) dismiss();
    if (target?.querySelector?.("[data-added]")) added(source);
    if (!target?.matches("[role=status]") || !target.firstElementChild || isAutomatic(source)) return;
    // What a message takes the place of may have had an undo.
    document.dispatchEvent(new CustomEvent("lineside:reported"));
    // A message beside a field may be outside the window: on a phone the button is a pad below it. Scroll only for
    // the person who clicked; what sticks to the foot of the window is always in it.
    const wrong = target.closest("form")?.querySelector("td > [aria-invalid]")?.closest("tr");
    if (!target.closest(".tray, .parameters-report")) reveal(wrong ?? target);
  });
  document.addEventListener("htmx:error", (event) => {
    const form = content.querySelector("[data-pending]");
    if (form) unanswered(form);
    else if (event.detail.ctx?.sourceElement.matches("[data-once]"))
      explain(document.getElementById("setpoint-error"), word("outcomeUnknown"));
  });
}
