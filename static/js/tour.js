// The tour of a demo: five steps over the line page, until they were seen or skipped; the menu of the user begins it again.

const SEEN = "lineside-tour-seen";
const tour = /** @type {HTMLElement} */ (document.getElementById("tour"));
const steps = /** @type {HTMLElement[]} */ ([...tour.querySelectorAll("[data-tour-at]")]);
let step = 0;

/** The place of a step that this window shows: a phone has another one than a panel. */
function place() {
  const all = /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll(steps[step]?.dataset.tourAt ?? ""));
  return [...all].find((each) => each.checkVisibility());
}

function show() {
  for (const [number, each] of steps.entries()) each.hidden = number !== step;
  const number = tour.querySelector("[data-tour-number]");
  if (number) number.textContent = `${step + 1}`;
  const next = /** @type {HTMLElement} */ (tour.querySelector("[data-tour-next]"));
  const isLast = step === steps.length - 1;
  next.dataset.first ??= next.textContent ?? "";
  next.textContent = (isLast ? next.dataset.last : next.dataset.first) ?? "";
  /** @type {HTMLElement} */ (tour.querySelector("[data-tour-skip]")).hidden = isLast;
  /** @type {HTMLElement} */ (tour.querySelector("[data-tour-back]")).hidden = step === 0;
  document.querySelector(".tour-at")?.classList.remove("tour-at");
  const at = place();
  at?.classList.add("tour-at");
  tour.showPopover();
}

function end() {
  tour.hidePopover();
  document.querySelector(".tour-at")?.classList.remove("tour-at");
  localStorage.setItem(SEEN, "true");
}

document.addEventListener("click", (event) => {
  const pressed = /** @type {Element} */ (event.target);
  if (pressed.closest("[data-tour-skip]")) end();
  else if (pressed.closest("[data-tour-next]")) {
    step += 1;
    if (step < steps.length) show();
    else end();
  } else if (pressed.closest("[data-tour-back]")) {
    step -= 1;
    show();
    if (step === 0) /** @type {HTMLElement} */ (tour.querySelector("[data-tour-next]")).focus();
  } else if (pressed.closest("[data-tour]")) {
    localStorage.removeItem(SEEN);
    if (location.pathname === "/") {
      step = 0;
      for (const menu of /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll(":popover-open"))) menu.hidePopover();
      show();
    } else location.assign("/");
  }
});
document.addEventListener("keydown", (event) => {
  if (event.key === "Escape" && tour.matches(":popover-open")) end();
});
if (location.pathname === "/" && !localStorage.getItem(SEEN)) show();
