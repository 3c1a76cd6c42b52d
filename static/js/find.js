// Find anything: Ctrl or ⌘ K and the button in the head open the field over the page; arrow keys go through what it finds.

const dialog = /** @type {HTMLDialogElement | null} */ (document.getElementById("find"));

export function start() {
  if (!document.getElementById("find-typed")) return;
  addEventListener("keydown", (event) => {
    const typing = /** @type {Element} */ (event.target).matches("input, textarea, select, [contenteditable]");
    if (event.key === "?" && !typing) document.getElementById("legend")?.togglePopover();
    if (event.key.toLowerCase() !== "k" || !(event.ctrlKey || event.metaKey) || event.altKey || event.shiftKey) return;
    event.preventDefault();
    open();
  });
  document.addEventListener("click", (event) => {
    const link = /** @type {Element} */ (event.target).closest("[data-find], .find__place[href^='#']");
    if (link?.matches(".find__place")) {
      // An action of this page, which the script that knows it carries out.
      event.preventDefault();
      dialog?.close();
      if (link.matches("[data-press-zero]")) /** @type {HTMLElement | null} */ (document.querySelector(".zero"))?.click();
      return;
    }
    if (!link || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    open();
  });
  document.addEventListener("keydown", choose);
  // It would stand over the words that nothing is known, with states in it.
  document.addEventListener("lineside:lost", () => dialog?.close());
  dialog?.addEventListener("click", (event) => {
    if (event.target === dialog) dialog.close();
  });
}

/** Nothing over a review: its time runs. On the page of the same name the field is there. */
function open() {
  if (dialog && !document.querySelector("dialog[open]")) dialog.showModal();
  const field = /** @type {HTMLInputElement} */ (document.getElementById("find-typed"));
  if (!field.closest("dialog:not([open])")) field.select();
}

/** @param {KeyboardEvent} event */
function choose(event) {
  const target = /** @type {HTMLElement} */ (event.target);
  const inField = target.id === "find-typed";
  // In a search field Escape would empty it first.
  if (inField && event.key === "Escape") dialog?.close();
  if (!inField && !target.matches(".find__place")) return;
  const places = [...document.querySelectorAll(".find__place")];
  const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
  if (step) {
    event.preventDefault();
    const next = places.indexOf(target) + step;
    if (next < 0) document.getElementById("find-typed")?.focus();
    else /** @type {HTMLElement} */ (places[next])?.focus();
  } else if (event.key === "Enter" && inField && places.length && !event.isComposing) {
    event.preventDefault();
    /** @type {HTMLElement} */ (places[0]).click();
  }
}
