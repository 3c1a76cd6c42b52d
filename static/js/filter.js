// Shows the rows of a table that have what is typed in data-filter="#PLACE", or with data-filter-only those that are
// marked by data-differs; a group without a row is hidden, too.

/** @param {string} place */
function filter(place) {
  const typed = /** @type {HTMLInputElement | null} */ (document.querySelector(`[data-filter="${place}"]`));
  const only = /** @type {HTMLInputElement | null} */ (document.querySelector(`[data-filter-only="${place}"]`));
  const words = (typed?.value ?? "").toLowerCase().split(/\s+/).filter(Boolean);
  for (const row of document.querySelectorAll(`${place} tbody tr`)) {
    const text = [...row.querySelectorAll("td:first-child, th")].map((cell) => cell.textContent.toLowerCase()).join(" ");
    const isMarked = !only?.checked || row.hasAttribute("data-differs");
    row.hidden = !isMarked || !words.every((word) => text.includes(word));
  }
  for (const group of document.querySelectorAll(`${place} section`))
    group.hidden = !group.querySelector("tbody tr:not([hidden])");
  const none = /** @type {HTMLElement | null} */ (document.querySelector(`[data-filter-none="${place}"]`));
  if (none) none.hidden = Boolean(document.querySelector(`${place} tbody tr:not([hidden])`));
}

const places = new Set(
  [...document.querySelectorAll("[data-filter]")].map((field) => /** @type {HTMLElement} */ (field).dataset.filter ?? ""),
);
const filterAll = () => places.forEach(filter);
document.addEventListener("input", (event) => {
  if (/** @type {Element} */ (event.target).matches("[data-filter], [data-filter-only]")) filterAll();
});
document.addEventListener("lineside:changed", filterAll);
filterAll();
