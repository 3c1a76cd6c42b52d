// Parts of a page that the server draws are redrawn when the value that they depend on has changed.
//   data-redraw="GROUP.FIELD" data-drawn-of="what it was when the part was drawn" hx-trigger="lineside:redraw"
//   data-if-known   not while the value is empty: what was drawn stays until there is another
// Where more than a part is made from it, the complete page is, once no review is open on it:
//   data-reload="GROUP.FIELD" data-drawn-of="what it was when the page was drawn"
import { listen, value } from "./bind.js";

/** @type {WeakSet<HTMLElement>} */
const followed = new WeakSet();

/** @param {HTMLElement} part */
function follow(part) {
  if (followed.has(part)) return;
  followed.add(part);
  const key = part.dataset.redraw;
  const dot = key.indexOf(".");
  const field = key.slice(dot + 1);
  const end = listen(key.slice(0, dot), (fields) => {
    if (!part.isConnected) return end();
    const present = /** @type {string} */ (fields[field] ?? "");
    if (part.dataset.drawnOf === present || (!present && part.dataset.ifKnown !== undefined)) return;
    part.dataset.drawnOf = present;
    part.dispatchEvent(new CustomEvent("lineside:redraw"));
  });
}

/** @param {HTMLElement} page */
function followPage(page) {
  const key = page.dataset.reload;
  const dot = key.indexOf(".");
  const look = () => {
    const present = value(key);
    if (present === undefined || present === page.dataset.drawnOf || (!present && page.dataset.ifKnown !== undefined)) return;
    if (!document.querySelector("dialog[open], [data-review-place] > *")) location.reload();
  };
  listen(key.slice(0, dot), look);
  // The review is taken away after that.
  document.addEventListener("lineside:done", () => setTimeout(look));
}

export function start() {
  for (const page of document.querySelectorAll("[data-reload]")) followPage(page);
  followParts();
  document.addEventListener("lineside:changed", followParts);
}

function followParts() {
  for (const part of document.querySelectorAll("[data-redraw]")) follow(part);
}
