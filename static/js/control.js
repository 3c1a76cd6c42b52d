// Control of the line in the head and in place: a request that has just come, and what goes on once control is there.
// What was refused is repeated as the person pressed it; a command still has its review.
const FRESH_MS = 1000;
const COVERED_MS = 500;
/** What was pressed last outside of the review, to be pressed again.
 * @type {{ source: HTMLElement, submitter: HTMLElement | null } | null} */
let pressed = null;
let known = "";
/** Control was pressed together with what needs it. */
let goesOn = false;

/** A finger that was on its way when a request came does not decide on it. */
function shield() {
  const box = document.querySelector("[data-requested]");
  const now = box?.dataset.requested ?? "";
  if (box && now !== known) {
    const choice = /** @type {HTMLElement} */ (box.lastElementChild);
    choice.inert = true;
    setTimeout(() => (choice.inert = false), FRESH_MS);
  }
  if (now !== known) rest();
  known = now;
}

/** A request lies over the page or has gone from there: a finger on its way presses nothing below it. */
function rest() {
  const { style } = /** @type {HTMLElement} */ (document.querySelector(".main"));
  style.pointerEvents = "none";
  setTimeout(() => (style.pointerEvents = ""), COVERED_MS);
}

function resume() {
  for (const offer of document.querySelectorAll("[data-control-offer]")) offer.remove();
  // On the page of a refusal; the one before has what was typed.
  if (!pressed) return history.back();
  if (!pressed.source.isConnected) return;
  const { source, submitter: by } = pressed;
  if (source.matches("form")) /** @type {HTMLFormElement} */ (source).requestSubmit(by?.isConnected ? by : null);
  else source.click();
}

/** @param {HTMLElement} source */
const acts = (source) =>
  !source.closest("[data-review-place], [data-control-offer], [data-head-control]") && !source.hasAttribute("hx-trigger");

export function start() {
  document.addEventListener("htmx:before:request", (event) => {
    const { request, sourceElement: source } = event.detail.ctx;
    if (acts(source)) pressed = { source, submitter: request.submitter ?? null };
    // The button is another one once its response is there.
    if (!source.hasAttribute("hx-trigger")) goesOn = source.matches("[data-then-resume]");
  });
  document.addEventListener("click", ({ target }) => target.closest("[data-resume]") && resume());
  document.addEventListener("htmx:after:swap", () => {
    shield();
    if (!goesOn || !document.querySelector("[data-control-offer] [data-resume]")) return;
    goesOn = false;
    resume();
  });
  shield();
}
