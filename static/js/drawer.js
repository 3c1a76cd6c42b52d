// Drawers and what stands beside them: one that was refused opens again, a secret is copied, and a page that a form made
// is loaded again as the page that it shows.

export function start() {
  const shown = /** @type {HTMLElement | null} */ (document.querySelector("[data-reload-as]"));
  if (shown) history.replaceState(null, "", shown.dataset.reloadAs);
  /** @type {HTMLElement | null} */ (document.querySelector("[popover][data-opened]"))?.showPopover();
  document.addEventListener("click", (event) => {
    const button = /** @type {HTMLElement | null} */ (
      /** @type {Element} */ (event.target).closest("[data-copy]")
    );
    if (button) copy(button);
  });
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
