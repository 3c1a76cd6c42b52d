// What pages with tables and forms have: filters, boxes that are counted, drawers.
export function start() {
  followFilters();
  followBoxes();
  followDrawers();
}

// Shows the rows of a place that have what is typed in data-filter="#PLACE", with data-filter-heads in number or name, or
// with data-filter-only those that are marked by data-differs; a group without a row is hidden, too.
const ROWS = ":is(tbody tr, .settings__row)";

/** @param {HTMLInputElement} typed */
function filter(typed) {
  const { filter: place = "", filterHeads: isByHeads } = typed.dataset;
  const only = /** @type {HTMLInputElement | null} */ (document.querySelector(`[data-filter-only="${place}"]`));
  const words = typed.value.toLowerCase().split(/\s+/).filter(Boolean);
  for (const row of document.querySelectorAll(`${place} ${ROWS}`)) {
    const parts = isByHeads === undefined ? [row] : [...row.querySelectorAll("td:first-child, th")];
    const text = parts.map((part) => part.textContent.toLowerCase()).join(" ");
    const isMarked = !only?.checked || row.hasAttribute("data-differs");
    row.hidden = !isMarked || !words.every((word) => text.includes(word));
  }
  for (const group of document.querySelectorAll(`${place} section`))
    group.hidden = !group.querySelector(`${ROWS}:not([hidden])`);
  const none = /** @type {HTMLElement | null} */ (document.querySelector(`[data-filter-none="${place}"]`));
  if (none) none.hidden = Boolean(document.querySelector(`${place} ${ROWS}:not([hidden])`));
}

function filterAll() {
  for (const typed of document.querySelectorAll("[data-filter]")) filter(/** @type {HTMLInputElement} */ (typed));
}

function followFilters() {
  document.addEventListener("input", (event) => {
    if (/** @type {Element} */ (event.target).matches("[data-filter], [data-filter-only]")) filterAll();
  });
  document.addEventListener("lineside:changed", filterAll);
  // What was typed before the page was loaded again is still in the fields.
  filterAll();
}

// A form whose button names how many of its boxes are ticked: data-counts-one and data-counts-many hold the texts,
// data-counts-none that of a form that may be sent without any.
/** @param {HTMLElement} form */
function count(form) {
  const ticked = form.querySelectorAll("input[type=checkbox]:checked").length;
  const { countsNone, countsOne, countsMany } = form.dataset;
  const text = (ticked === 0 && countsNone) || (ticked === 1 ? countsOne : countsMany);
  const button = form.querySelector("[data-counts-act]");
  if (!button) return;
  /** @type {HTMLElement} */ (button.querySelector("span")).textContent = text.replace("{n}", String(ticked));
  button.disabled = ticked === 0 && !countsNone;
}

function followBoxes() {
  // A browser that goes back fills the boxes in as they were left.
  for (const form of document.querySelectorAll("[data-counts-one]")) count(form);
  document.addEventListener("change", (event) => {
    const form = event.target.closest("[data-counts-one]");
    if (form) count(form);
  });
}

// Drawers and what stands beside them: one opens with what htmx has put into it, or again with what was refused, a secret
// is copied, and a page that a form made is loaded again as the page that it shows.
function followDrawers() {
  const shown = /** @type {HTMLElement | null} */ (document.querySelector("[data-reload-as]"));
  if (shown) history.replaceState(null, "", shown.dataset.reloadAs);
  const opened = /** @type {HTMLElement | null} */ (document.querySelector("[popover][data-opened]"));
  if (opened) fill(opened);
  document.addEventListener("toggle", entered, { capture: true });
  document.addEventListener("focusout", left);
  document.addEventListener("htmx:after:swap", ({ detail: { ctx } }) => {
    const drawer = typeof ctx.target === "string" ? document.querySelector(ctx.target) : ctx.target;
    if (drawer?.matches(".drawer")) fill(/** @type {HTMLElement} */ (drawer));
  });
  document.addEventListener("click", (event) => {
    const button = /** @type {HTMLElement | null} */ (
      /** @type {Element} */ (event.target).closest("[data-copy]")
    );
    if (button) copy(button);
  });
}

/** The focus goes into a drawer that opens, so that a screen reader reads its title.
 * @param {Event} event */
function entered(event) {
  const drawer = /** @type {HTMLElement} */ (event.target);
  if (drawer.matches(".drawer:popover-open") && !drawer.contains(document.activeElement)) focusFirst(drawer);
}

/** What a drawer covers cannot have the focus: the drawer closes, and keeps what is typed in it.
 * @param {FocusEvent} event */
function left({ target, relatedTarget }) {
  const drawer = /** @type {HTMLElement | null} */ (/** @type {Element} */ (target).closest(".drawer:popover-open"));
  if (drawer && relatedTarget && !drawer.contains(/** @type {Node} */ (relatedTarget))) drawer.hidePopover();
}

/** The browser gives the focus back to what has opened a drawer once it is closed.
 * @param {HTMLElement} drawer */
function fill(drawer) {
  if (!drawer.matches(":popover-open")) drawer.showPopover();
  focusFirst(drawer);
}

/** @param {HTMLElement} drawer */
function focusFirst(drawer) {
  drawer.scrollTop = 0;
  const first = drawer.querySelector("[aria-invalid]") ?? drawer.querySelector("[autofocus]") ?? drawer.querySelector("button");
  /** @type {HTMLElement | null} */ (first)?.focus();
}

/** A browser has a clipboard for scripts only where the page came by TLS; the selection can be copied everywhere.
 * @param {HTMLElement} button */
async function copy(button) {
  const source = /** @type {HTMLElement} */ (document.getElementById(button.dataset.copy ?? ""));
  getSelection()?.selectAllChildren(source);
  try {
    await navigator.clipboard.writeText(source.textContent ?? "");
  } catch {
    if (!document.execCommand("copy")) return;
  }
  button.textContent = button.dataset.copied ?? "";
}
