// The review of a change to zero is not over when a unit of its line can no longer take it, or takes it otherwise: it is
// drawn again, and says so before it is confirmed.
import { fieldsOf, listen } from "./bind.js";
import { nameTicked, signalsOf, whyNot } from "./review.js";

/** What changes together is drawn once. */
const REDRAW_MS = 300;
/** The lines that a person has left out of a review that is being drawn again. @type {string[]} */
let unticked = [];
document.addEventListener("lineside:done", () => {
  unticked = [];
});

/** Follow the units of a review, until the returned function is called.
 * @param {HTMLElement} part what requests the review again @param {HTMLElement} place where the review is */
export function redrawWith(part, place) {
  untick(place);
  let timer = 0;
  const redraw = () => {
    unticked = boxes(place).flatMap((box) => (box.checked ? [] : box.value));
    part.dispatchEvent(new CustomEvent("lineside:redraw"));
  };
  const endings = (part.dataset.reviewUnits?.split(" ") ?? []).map((unit) => {
    const drawn = takes(fieldsOf(unit));
    return listen(unit, (fields) => {
      if (takes(fields) !== drawn) timer ||= setTimeout(redraw, REDRAW_MS);
    });
  });
  return () => {
    clearTimeout(timer);
    for (const end of endings) end();
  };
}

/** Whether and how a unit takes a change to zero. @param {Fields | undefined} fields */
const takes = (fields) => fields && [whyNot(fields), signalsOf(fields)].join();

/** @param {HTMLElement} place */
const boxes = (place) => [
  .../** @type {NodeListOf<HTMLInputElement>} */ (place.querySelectorAll("[data-verbs] input")),
];

/** What was left out stays so in the review that is drawn again. @param {HTMLElement} place */
function untick(place) {
  const lines = /** @type {HTMLElement | null} */ (place.querySelector("[data-verbs]"));
  if (lines && unticked.length) {
    for (const box of boxes(place)) box.checked = !unticked.includes(box.value);
    nameTicked(lines);
  }
  unticked = [];
}
