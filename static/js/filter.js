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

export function start() {
  document.addEventListener("input", (event) => {
    if (/** @type {Element} */ (event.target).matches("[data-filter], [data-filter-only]")) filterAll();
  });
  document.addEventListener("lineside:changed", filterAll);
  // What was typed before the page was loaded again is still in the fields.
  filterAll();
}
