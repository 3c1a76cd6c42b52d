// The number pad for a field without one: on touch, in place of the device's keyboard, which a panel on the wall may
// not have. It opens on the side of the screen where the field is not, and shows whose value it writes and the limits.
// setter.js handles the keys with data-pad.
const NUMBERS = "input.input--number:enabled";
const CLEAR_PX = 12;

let pad = null;
let field = null;
let touched = null;

const isSigned = (input) => input.dataset.together === "offset";
const labelOf = (input) => input.ariaLabel ?? input.labels[0]?.textContent.trim() ?? "";
const hintOf = (input) =>
  input.dataset.limits ?? document.querySelector(`#${input.getAttribute("aria-describedby")}.field__hint`)?.textContent;

function build() {
  pad = document.getElementById("keypad").content.firstElementChild.cloneNode(true);
  // A key pressed here is typed there: the field keeps the focus.
  pad.addEventListener("mousedown", (event) => event.preventDefault());
  pad.addEventListener("click", ({ target }) => {
    if (target.closest("[data-keypad-done]")) field.blur();
    else if (target.closest("[data-keypad-next]")) goOn();
  });
  document.getElementById("main").append(pad);
}

function open(input) {
  if (!pad) build();
  // The first key replaces the text, the next ones append; so do those after another touch of the field.
  if (field !== input) input.select();
  field = input;
  input.inputMode = "none";
  input.id ||= `field-${crypto.getRandomValues(new Uint32Array(1))[0]}`;
  pad.dataset.padFor = input.id;
  pad.querySelector("[data-keypad-label]").textContent = labelOf(input);
  pad.querySelector("[data-keypad-limits]").textContent = hintOf(input) ?? "";
  pad.querySelector('[data-pad="-"]').disabled = !isSigned(input);
  const { left, width } = input.getBoundingClientRect();
  pad.dataset.side = left + width / 2 > innerWidth / 2 ? "start" : "end";
  pad.hidden = false;
  document.body.dataset.keypad = "";
  uncover();
}

/** The field is not left behind the pad. */
function uncover() {
  const at = field.getBoundingClientRect();
  const over = pad.getBoundingClientRect();
  const isBeside = at.right < over.left || at.left > over.right;
  if (!isBeside && at.bottom > over.top - CLEAR_PX)
    scrollBy({ top: at.bottom - over.top + CLEAR_PX, behavior: "instant" });
}

function close() {
  if (!field) return;
  field = null;
  pad.hidden = true;
  delete document.body.dataset.keypad;
}

function goOn() {
  const all = [...document.querySelectorAll(NUMBERS)].filter((input) => input.checkVisibility());
  const next = all.slice(all.indexOf(field) + 1).find((input) => input.form === field.form && !input.closest("[inert]"));
  if (!next) return field.blur();
  next.focus({ preventScroll: true });
  next.scrollIntoView({ block: "nearest" });
  uncover();
}

const hasOwnPad = (input) => input.id && document.querySelector(`[data-pad-for="${input.id}"]:not(.keypad)`);

export function start() {
  if (!document.getElementById("keypad")) return;
  document.addEventListener("pointerdown", ({ target, pointerType }) => {
    const input = target.closest?.(NUMBERS);
    touched = pointerType === "touch" && input && !hasOwnPad(input) ? input : null;
    if (touched) touched.inputMode = "none";
  });
  document.addEventListener("focusin", ({ target }) => {
    if (target === touched || (field && target.matches(NUMBERS) && !hasOwnPad(target))) open(target);
  });
  // A field that is touched again has the focus already.
  document.addEventListener("click", ({ target }) => {
    if (target === touched && target === document.activeElement) open(target);
  });
  document.addEventListener("focusout", ({ relatedTarget }) => relatedTarget?.matches(NUMBERS) || close());
  document.addEventListener("keydown", ({ key }) => key === "Escape" && close());
  document.addEventListener("lineside:changed", () => field && !field.isConnected && close());
  document.addEventListener("lineside:lost", close);
}
