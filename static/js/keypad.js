// The number pad for a field without one: on touch, in place of the device's keyboard, which a panel on the wall may
// not have. It opens on the side of the screen where the field is not, and shows whose value it writes and the limits.
// setter.js handles the keys with data-pad.
const NUMBERS = "input.input--number:enabled";
const CLEAR_PX = 12;

/** @type {HTMLElement} */
let pad;
/** @type {HTMLInputElement | null} */
let field = null;
/** @type {HTMLInputElement | null} */
let touched = null;

/** @param {HTMLInputElement} input */
const isSigned = (input) => input.dataset.together === "offset";
/** @param {HTMLInputElement} input */
const labelOf = (input) => input.ariaLabel ?? input.labels?.[0]?.textContent.trim() ?? "";
/** @param {HTMLInputElement} input */
const hintOf = (input) =>
  input.dataset.limits ?? document.querySelector(`#${input.getAttribute("aria-describedby")}.field__hint`)?.textContent;

function build() {
  const { firstElementChild } = document.getElementById("keypad").content;
  pad = /** @type {HTMLElement} */ (firstElementChild?.cloneNode(true));
  // A key pressed here is typed there: the field keeps the focus.
  pad.addEventListener("mousedown", (event) => event.preventDefault());
  pad.addEventListener("click", ({ target }) => {
    if (target.closest("[data-keypad-done]")) field?.blur();
    else if (target.closest("[data-keypad-next]")) goOn();
  });
  document.getElementById("main").append(pad);
}

/** @param {HTMLInputElement} input */
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
  showTyped();
  uncover();
}

function showTyped() {
  pad?.querySelector("[data-keypad-value]")?.replaceChildren(field?.value ?? "");
}

/** The field is not left behind the pad. */
function uncover() {
  if (!field) return;
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
  if (!field) return;
  const { form } = field;
  const all = [...document.querySelectorAll(NUMBERS)].filter((input) => input.checkVisibility());
  const next = all.slice(all.indexOf(field) + 1).find((input) => input.form === form && !input.closest("[inert]"));
  if (!next) return field.blur();
  next.focus({ preventScroll: true });
  next.scrollIntoView({ block: "nearest" });
  uncover();
}

/** @param {HTMLInputElement} input */
const hasOwnPad = (input) => input.id && document.querySelector(`[data-pad-for="${input.id}"]:not(.keypad)`);

export function start() {
  if (!document.getElementById("keypad")) return;
  document.addEventListener("pointerdown", ({ target, pointerType }) => {
    const input = target.closest?.(NUMBERS);
    touched = pointerType === "touch" && input && !hasOwnPad(input) ? input : null;
    if (touched) touched.inputMode = "none";
  });
  document.addEventListener("focusin", ({ target }) => {
    if (touched && target === touched) open(touched);
    else if (field && target.matches(NUMBERS) && !hasOwnPad(target)) open(target);
  });
  // A field that is touched again has the focus already.
  document.addEventListener("click", ({ target }) => {
    if (touched && target === touched && target === document.activeElement) open(touched);
  });
  document.addEventListener("focusout", ({ relatedTarget }) => relatedTarget?.matches(NUMBERS) || close());
  document.addEventListener("input", showTyped);
  document.addEventListener("keydown", ({ key }) => key === "Escape" && close());
  document.addEventListener("lineside:changed", () => field && !field.isConnected && close());
  document.addEventListener("lineside:lost", close);
}
