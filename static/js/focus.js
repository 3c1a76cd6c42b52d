// Where a person was at work by keyboard. What makes that place unusable for a while, or puts a new one in its
// stead (a unit that does not respond, a lost server, a row that was written), gives the focus back here. For a place
// that is hidden or gone, the nearest part around it has the focus, never the page.
const PLACES = ".main, .rail, .top";
/** @type {Place | null} */
let last = null;
/** The part that has the focus for that place. @type {HTMLElement | null} */
let standIn = null;

const isNowhere = () => {
  const { activeElement } = document;
  return activeElement === document.body || activeElement === standIn || activeElement?.matches(".gone");
};

/** @param {On<FocusEvent>} event */
function remember(event) {
  const element = event.target;
  // Who looks about while a review is open comes back from it to where it was opened.
  if (!element.closest?.(PLACES) || document.querySelector("[data-review-place] [data-review]")) return;
  if (element === standIn || element.closest("[data-review-place]")) return;
  // A browser takes half an item of the rail or of the tabs for seen.
  if (element.matches(".rail__item, .tabs__tab")) element.scrollIntoView({ block: "nearest", inline: "nearest" });
  const around = [];
  for (let part = element.parentElement; part && part !== document.body; part = part.parentElement) around.push(part);
  last = { element, home: element.parentElement?.closest("[id]")?.id, twin: twinOf(element), around };
}

/** Find the same control in a part of the page that was redrawn.
 * @param {Element} element */
function twinOf(element) {
  const known = ["name", "value", "type", "href", "aria-label"]
    .filter(
      (attribute) => element.hasAttribute(attribute) && (attribute !== "value" || element.matches("button")),
    )
    .map((attribute) => `[${attribute}="${CSS.escape(element.getAttribute(attribute) ?? "")}"]`);
  return element.tagName.toLowerCase() + known.join("");
}

/** @param {Place} place */
function successor({ element, home, twin }) {
  if (element.isConnected) return element;
  return document.getElementById(home ?? "")?.querySelector(twin) ?? null;
}

/** Give the focus back where it has been lost; a person who put it elsewhere keeps it there.
 * @param {boolean} [isShown] whether the place is scrolled into view, after an act of the person */
export function giveBack(isShown) {
  if (!last || !isNowhere()) return;
  const element = successor(last) ?? last.element;
  if (element.closest("[inert]")) return;
  if (!takesFocus(element)) last.around.find(standsIn);
  if (isShown) document.activeElement?.scrollIntoView({ block: "nearest" });
}

/** @param {HTMLElement} part */
function takesFocus(part) {
  part.focus({ preventScroll: true });
  return document.activeElement === part;
}

/** @param {HTMLElement} part */
function standsIn(part) {
  standIn = part;
  if (!part.hasAttribute("tabindex")) part.tabIndex = -1;
  return takesFocus(part);
}

/** Leave what was hidden, as a field is whose unit leaves REMOTE. @param {FocusEvent} event */
function leave({ target }) {
  if (target === last?.element && !last.element.checkVisibility({ visibilityProperty: true })) setTimeout(giveBack);
}

/** A table is a stop of the Tab key while there is something to scroll in it. */
function findScrollable() {
  for (const table of document.querySelectorAll(".table-wrap")) {
    const scrolls = table.scrollWidth > table.clientWidth && getComputedStyle(table).overflowX !== "visible";
    if (scrolls) table.setAttribute("tabindex", "0");
    else if (table !== document.activeElement) table.removeAttribute("tabindex");
  }
}

export function start() {
  findScrollable();
  document.addEventListener("lineside:changed", findScrollable);
  document.addEventListener("lineside:changed", () => giveBack());
  document.addEventListener("focusout", leave);
  addEventListener("load", findScrollable);
  addEventListener("resize", findScrollable);
  document.addEventListener("focusin", remember);
  // A press elsewhere leaves the place; the pressed control takes the focus itself, unless it has it.
  document.addEventListener("pointerdown", ({ target }) => { if (!last?.element.contains(target)) last = null; }, { capture: true });
}
