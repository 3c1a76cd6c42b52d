// The controls around the picture: presses and fields change the view, and show what it is.
import { exportAddress } from "./trends-data.js";
import { fromField, toField } from "./trends-time.js";
import { MAX_VALUES } from "./trends-view.js";

/** By what a button moves: data-move. @type {Record<string, (view: View) => void>} */
const MOVES = {
  back: (view) => view.pan(-0.5),
  on: (view) => view.pan(0.5),
  in: (view) => view.zoom(0.5),
  out: (view) => view.zoom(2),
  live: (view) => view.toggleLive(),
};

/** Let the controls of the page change the view. `words`: its texts; `explain` shows why nothing was changed, or "".
 * @param {HTMLElement} root @param {View} view @param {TrendWords} words @param {(fault: string) => void} explain */
export function bindControls(root, view, words, explain) {
  root.addEventListener("click", ({ target }) => {
    const button = target.closest("[data-span], [data-preset], [data-move]");
    if (button) press(button, view);
  });
  document.getElementById("trend-exact").addEventListener("submit", (event) => {
    event.preventDefault();
    explain(showExactly(view, words));
  });
  const [scale, marks] = [document.getElementById("trend-scale"), document.getElementById("trend-marks")];
  const compare = document.getElementById("trend-compare");
  scale.addEventListener("change", () => view.change({ scale: scale.value }));
  compare.addEventListener("change", () => view.change({ compare: compare.value }));
  marks.addEventListener("change", () => view.change({ marks: marks.checked }));
  document.getElementById("trend-add").addEventListener("submit", (event) => {
    event.preventDefault();
    const { unit, value } = document.getElementById("trend-add").elements;
    if (view.series.length >= MAX_VALUES) explain(words.full);
    else view.add(`${unit.value}/${value.value}`);
  });
}

/** @param {HTMLElement} button @param {View} view */
function press(button, view) {
  const { span, preset, move } = button.dataset;
  if (span) view.follow(Number(span));
  else if (preset) view.showPreset(preset);
  else if (move) MOVES[move](view);
}

/** Show the span of the two fields; return why they are none, or "". @param {View} view @param {TrendWords} words */
function showExactly(view, words) {
  const { from, to } = document.getElementById("trend-exact").elements;
  const [start, end] = [fromField(from.value), fromField(to.value)];
  if (Number.isNaN(end - start)) return words.malformed;
  if (end <= start) return words.backwards;
  view.show(start, end);
  return "";
}

/** Show in the controls what the view is. @param {HTMLElement} root @param {View} view */
export function showControls(root, view) {
  const [from, to] = view.range();
  const spans = view.live && !view.preset && view.from === null;
  for (const button of root.querySelectorAll("[data-span]"))
    setPressed(button, spans && Number(button.dataset.span) === view.span);
  for (const button of root.querySelectorAll("[data-preset]")) setPressed(button, view.preset === button.dataset.preset);
  setPressed(root.querySelector("[data-move=live]"), view.live);
  const exact = document.getElementById("trend-exact");
  if (!exact.contains(document.activeElement)) {
    exact.elements.from.value = toField(from);
    exact.elements.to.value = toField(to);
  }
  document.getElementById("trend-scale").value = view.scale;
  document.getElementById("trend-compare").value = view.compare;
  document.getElementById("trend-marks").checked = view.marks;
  document.getElementById("trend-save").elements.query.value = String(view.query());
  for (const file of ["csv", "data", "parquet"]) {
    const link = /** @type {HTMLAnchorElement | null} */ (document.getElementById(`export-${file}`));
    if (link) link.href = exportAddress(view.series, [from, to], file);
  }
}

/** @param {HTMLElement} button @param {boolean} isPressed */
const setPressed = (button, isPressed) => button.setAttribute("aria-pressed", String(isPressed));
