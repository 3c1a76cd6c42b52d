// A form whose button names how many of its boxes are ticked: data-counts-one and data-counts-many hold the texts.
/** @param {HTMLElement} form */
function count(form) {
  const ticked = form.querySelectorAll("input[type=checkbox]:checked").length;
  const text = ticked === 1 ? form.dataset.countsOne : form.dataset.countsMany;
  const button = form.querySelector("[data-counts-act]");
  if (!button) return;
  /** @type {HTMLElement} */ (button.querySelector("span")).textContent = text.replace("{n}", String(ticked));
  button.disabled = ticked === 0;
}

export function start() {
  // A browser that goes back fills the boxes in as they were left.
  for (const form of document.querySelectorAll("[data-counts-one]")) count(form);
  document.addEventListener("change", (event) => {
    const form = event.target.closest("[data-counts-one]");
    if (form) count(form);
  });
}
