// The review dialog: focus rests on Cancel, Enter does not execute, it lapses after 30 s, when the value has moved
// or the unit takes nothing from here any more, and nothing leaves while the server does not respond.
import { listen, rebind, value } from "./bind.js";
import * as clock from "./clock.js";
import { giveBack } from "./focus.js";
import { isLive } from "./live.js";
import { word } from "./words.js";

const LAPSE_MS = 30_000;
const dialog = document.getElementById("review");
const content = document.getElementById("review-body");
/** @type {(() => void)[]} */
let endings = [];
/** The last thing clicked that only reads, before the first message of the server.
 * @type {HTMLElement | null} */
let early = null;

function opened() {
  close();
  if (!content.firstElementChild) return;
  if (!content.querySelector("[data-review-cancel]")) content.append(closer());
  show();
  const form = content.querySelector("[data-review]");
  if (form) watch(form);
}

function show() {
  if (!dialog.open) dialog.showModal();
  dialog.classList.toggle("dialog--wide", Boolean(content.querySelector(".review--wide")));
  // Show the head first; the button with the focus is visible anyway.
  content.querySelector("[data-review-cancel]")?.focus({ preventScroll: true });
  dialog.scrollTop = 0;
}

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
}

/** One unit: the form names it; several: a row each, with the name.
 * @param {HTMLElement} form @param {HTMLElement} part */
function watchUnit(form, part) {
  const { of: unit, watch: key, was, name } = part.dataset;
  const group = unit ?? key?.slice(0, key.indexOf("."));
  if (!group) return;
  endings.push(
    listen(group, (fields) => {
      const present = key ? value(key) : undefined;
      const moved = present !== undefined && present !== was ? word("moved", present) : "";
      const reason = (unit ? whyNot(fields) : "") || moved;
      if (reason) end(form, name ? `${name}: ${reason}` : reason);
    }),
  );
}

/** Why a unit takes nothing from here any more; empty while it does.
 * @param {Fields} fields */
function whyNot({ link, mode, blocked }) {
  if (link !== "online") return word("stoppedResponding");
  if (mode !== "remote") return word("leftRemote");
  return blocked ? word("wasBlocked", blocked) : "";
}

/** A part of the page that is fetched as the page is opened or on its way, and not by a press.
 * @param {Element} source */
const isAutomatic = (source) => source.hasAttribute("hx-trigger");

/** The review is over without a command: the button is gone and the reason stays.
 * @param {HTMLElement} form @param {string} reason */
function end(form, reason) {
  close();
  if (form.dataset.pending !== undefined || form.dataset.ended !== undefined) return;
  form.dataset.ended = "";
  const words = form.querySelector("[data-review-end]");
  words.textContent = reason;
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
  const done = content.querySelector("[data-review-done]");
  if (done) return done.dataset.reviewDone;
  return content.querySelector("[data-ended]:not([data-unanswered])") ? "ended" : "";
}

function dismiss() {
  close();
  const detail = outcome();
  if (dialog.open) dialog.close();
  document.dispatchEvent(new CustomEvent("lineside:done", { detail }));
  content.replaceChildren();
  giveBack();
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
  for (const undo of document.querySelectorAll("[data-undo]")) undo.remove();
}

/** Show that the request got no response, so the outcome is unknown.
 * @param {HTMLElement} form */
function unanswered(form) {
  delete form.dataset.pending;
  form.dataset.unanswered = "";
  for (const button of form.querySelectorAll("button")) button.disabled = false;
  end(form, word("outcomeUnknown"));
}

/** Of a press that had no review. */
function showNoResponse() {
  const words = document.createElement("p");
  words.className = "field__error";
  words.textContent = word("outcomeUnknown");
  document.getElementById("setpoint-error")?.replaceChildren(words);
}

/** End the review when the connection is lost; a pending command is reported as unknown after the reconnect.
 * What is typed in a field stays. */
function lost() {
  early = null;
  if (!dialog.open) return;
  const pending = content.querySelector("[data-pending]");
  if (pending) {
    unanswered(pending);
    return dialog.close();
  }
  content.querySelector("[data-review]")?.setAttribute("data-ended", "");
  dismiss();
}

function repeatEarly() {
  const source = early;
  early = null;
  if (!source?.isConnected) return;
  if (source.matches("form")) source.requestSubmit();
  else source.click();
}

/** A form that the browser sends: not while the server does not respond, and with the moment of the press,
 * so that one that is held up on the way is refused (app/web/arrival.py).
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
  dialog.addEventListener("click", (event) => {
    if (event.target.closest("[data-review-cancel]")) dismiss();
  });
  dialog.addEventListener("cancel", (event) => {
    if (content.querySelector("[data-pending]")) event.preventDefault();
    else dismiss();
  });
  dialog.addEventListener("keydown", (event) => {
    // Enter executes nothing but the button that has the focus.
    if (event.key === "Enter" && event.target.matches("input, select")) event.preventDefault();
  });
  dialog.addEventListener("input", (event) => {
    const typed = event.target.closest("[data-typed]");
    if (typed)
      content.querySelector("[data-review-act]").disabled = typed.value.trim() !== typed.dataset.typed;
  });
  document.addEventListener("lineside:lost", lost);
  document.addEventListener("lineside:found", () => {
    if (!dialog.open && content.querySelector("[data-unanswered]")) show();
    repeatEarly();
  });
  document.addEventListener("lineside:idle", () => {
    if (!content.querySelector("[data-pending]")) dismiss();
  });

  document.addEventListener("submit", submitted);
  document.addEventListener("htmx:config:request", (event) => {
    const { ctx } = event.detail;
    ctx.request.headers["Lineside-Clicked-At"] = clock.now().toFixed(3);
    // Another tab may look at another home, and the cookie is of both.
    if (document.body.dataset.home) ctx.request.headers["Lineside-Home"] = document.body.dataset.home;
    if (ctx.sourceElement.matches("[data-once]")) ctx.request.body.set("id", newId());
  });
  document.addEventListener("htmx:before:request", (event) => {
    const { request, sourceElement: source } = event.detail.ctx;
    // What only reads may come before the first message of the server; a click that reads is repeated then.
    if (!isLive() && !(request.method === "GET" && isAutomatic(source))) {
      if (request.method === "GET" && document.body.dataset.link !== "lost") early = source;
      return event.preventDefault();
    }
    if (source.matches("[data-review]")) lock(source);
  });
  document.addEventListener("htmx:after:swap", (event) => {
    rebind();
    document.dispatchEvent(new CustomEvent("lineside:changed"));
    giveBack();
    const named = event.detail.ctx.target;
    const target = typeof named === "string" ? document.querySelector(named) : named;
    if (target === content) opened();
    // A message beside a field may be outside the window: on a phone the button is a pad below it. Scroll only for
    // the person who clicked.
    else if (target?.matches("[role=status]") && target.firstElementChild && !isAutomatic(event.detail.ctx.sourceElement))
      target.scrollIntoView({ block: "nearest" });
  });
  document.addEventListener("htmx:error", (event) => {
    const form = content.querySelector("[data-pending]");
    if (form) unanswered(form);
    else if (event.detail.ctx?.sourceElement.matches("[data-once]")) showNoResponse();
  });
}
