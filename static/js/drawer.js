// Drawers and what stands beside them: one opens with what htmx has put into it, or again with what was refused, a secret
// is copied, and a page that a form made is loaded again as the page that it shows.

export function start() {
  const shown = /** @type {HTMLElement | null} */ (document.querySelector("[data-reload-as]"));
  if (shown) history.replaceState(null, "", shown.dataset.reloadAs);
  /** @type {HTMLElement | null} */ (document.querySelector("[popover][data-opened]"))?.showPopover();
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

/** The browser gives the focus back to what has opened a drawer once it is closed.
 * @param {HTMLElement} drawer */
function fill(drawer) {
  if (!drawer.matches(":popover-open")) drawer.showPopover();
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
