// The faceplate of a unit, beside the line: a press on a unit opens it, Escape closes it and the focus returns to that
// unit. A press with a key that opens another tab, or without this script, opens the page of the unit.
import { listen, rebind } from "./bind.js";
import { show } from "./visibility.js";

const plate = document.getElementById("faceplate");
/** The link of the unit that is shown, and that of the one that is on its way.
 * @type {HTMLAnchorElement | null} */
let opener = null;
/** @type {HTMLAnchorElement | null} */
let wanted = null;
/** Where the page stood when it was opened, and where the unit was scrolled into the window. */
let before = 0;
let after = 0;
let ending = () => {};

function opened() {
  const link = wanted;
  wanted = null;
  if (!link) return plate.replaceChildren();
  if (!plate.querySelector("[data-faceplate-close]")) return location.assign(link.href);
  forget();
  opener = link;
  link.setAttribute("aria-expanded", "true");
  const unit = link.closest("[data-unit]")?.dataset.unit ?? "";
  plate.setAttribute("data-unit", unit);
  plate.hidden = false;
  place(link);
  show(unit);
  document.dispatchEvent(new CustomEvent("lineside:changed"));
  plate.scrollTop = 0;
  plate.querySelector("h2 a")?.focus({ preventScroll: true });
  (link.closest("[data-unit]") ?? link).scrollIntoView({ block: "nearest" });
  after = scrollY;
  ending = listen("alarms_present", redrawAlarms);
}

/** Over the columns that are far from the unit: those at the end, or where that covers it those at the beginning.
 * @param {HTMLAnchorElement} link */
function place(link) {
  plate.removeAttribute("data-before");
  const { left, right } = (link.closest(".web__place") ?? link).getBoundingClientRect();
  const { left: from, width } = plate.getBoundingClientRect();
  plate.toggleAttribute("data-before", right > from && left > width);
}

/** @param {Fields} fields */
function redrawAlarms({ changed }) {
  const list = plate.querySelector("#faceplate-alarms");
  if (!list || list.dataset.drawnOf === changed) return;
  list.dataset.drawnOf = /** @type {string} */ (changed);
  list.dispatchEvent(new CustomEvent("lineside:redraw"));
}

function forget() {
  ending();
  opener?.removeAttribute("aria-expanded");
  show("");
}

/** A review of the unit that is shown ends with its faceplate; a command on its way keeps its place for the result. */
function leave() {
  if (plate.querySelector("[data-pending]")) return false;
  if (plate.querySelector("[data-review]")) document.dispatchEvent(new CustomEvent("lineside:idle"));
  return true;
}

/** Its place with the name, in the next picture: what it says is on its way.
 * @param {HTMLAnchorElement} link */
function begin(link) {
  before = scrollY;
  const head = document.createElement("header");
  head.className = "faceplate__head";
  const name = document.createElement("h2");
  name.className = "faceplate__name";
  const page = document.createElement("a");
  page.href = link.href;
  page.textContent = /** @type {HTMLElement} */ (link.querySelector("[title]") ?? link).title;
  name.append(page);
  head.append(name);
  plate.replaceChildren(head);
  plate.hidden = false;
  place(link);
  opener = link;
}

function close() {
  if (!opener || !leave()) return;
  wanted = null;
  forget();
  const isWhereItOpened = scrollY === after;
  plate.hidden = true;
  plate.replaceChildren();
  plate.removeAttribute("data-unit");
  rebind();
  document.dispatchEvent(new CustomEvent("lineside:changed"));
  opener.focus({ preventScroll: isWhereItOpened });
  if (isWhereItOpened) scrollTo(0, before);
  opener = null;
}

/** @param {HTMLAnchorElement} link */
const addressOf = (link) => `${link.getAttribute("href")}/faceplate`;

document.addEventListener("click", (event) => {
  if (event.target.closest("[data-faceplate-close]")) return close();
  const link = /** @type {HTMLAnchorElement | null} */ (event.target.closest("[data-faceplate]"));
  if (!link || event.ctrlKey || event.metaKey || event.shiftKey) return;
  event.preventDefault();
  if (link === wanted || !leave()) return;
  wanted = link;
  if (plate.hidden) begin(link);
  link.setAttribute("aria-busy", "true");
  plate.dispatchEvent(new CustomEvent("lineside:faceplate"));
});
document.addEventListener("htmx:config:request", ({ detail: { ctx } }) => {
  if (ctx.sourceElement === plate && wanted) ctx.request.action = addressOf(wanted);
});
document.addEventListener("htmx:after:swap", ({ detail: { ctx } }) => {
  if (ctx.sourceElement === plate) opened();
});
document.addEventListener("htmx:finally:request", ({ detail: { ctx } }) => {
  // Nothing has come, and no other unit is on its way.
  if (ctx.sourceElement !== plate || !wanted || !ctx.request.action.endsWith(addressOf(wanted))) return;
  wanted = null;
  if (!plate.querySelector("[data-faceplate-close]")) close();
});
// A review has scrolled its button into the window: what the unit does is in sight again.
document.addEventListener("lineside:done", () => (plate.scrollTop = 0));
document.addEventListener("keydown", (event) => {
  if (event.key !== "Escape" || event.defaultPrevented) return;
  // Escape closes a review first, wherever it is.
  if (!document.querySelector("dialog[open], [data-review-place] > *")) close();
});
