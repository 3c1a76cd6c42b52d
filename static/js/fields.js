// Fields that speak the language of the page and not of the browser: the chosen file, and what a field refuses.

const KILO = 1000;

/** The names and the size of the chosen files. @param {FileList} files */
function describe(files) {
  const size = [...files].reduce((sum, file) => sum + file.size, 0);
  const unit = size < KILO ** 2 ? "kilobyte" : "megabyte";
  /** @type {Intl.NumberFormatOptions} */
  const shape = { style: "unit", unit, maximumFractionDigits: 1 };
  const number = new Intl.NumberFormat(document.documentElement.lang, shape);
  const shown = number.format(size / (unit === "kilobyte" ? KILO : KILO ** 2));
  return `${[...files].map((file) => file.name).join(", ")} · ${shown}`;
}

function followFiles() {
  for (const shown of document.querySelectorAll("[data-chosen]")) {
    const input = /** @type {HTMLInputElement} */ (document.getElementById(shown.dataset.chosen ?? ""));
    const none = shown.textContent;
    const show = () => {
      shown.textContent = input.files?.length ? describe(input.files) : none;
    };
    input.addEventListener("change", show);
    show(); // a page that comes back keeps its file
  }
}

/** What stands below a refused field. @type {WeakMap<Element, HTMLElement>} */
const refusals = new WeakMap();

/** Say below the field what it needs: the bubble of the browser has another language and covers the next field.
 * @param {Event} event */
function refuse(event) {
  const field = /** @type {HTMLInputElement} */ (event.target);
  const isFirst = [...(field.form?.elements ?? [field])].find((each) => each.matches(":invalid:not(fieldset)")) === field;
  event.preventDefault();
  if (isFirst) field.focus();
  const refusal = refusals.get(field) ?? document.createElement("p");
  const { missing, unticked } = document.body.dataset;
  refusal.className = "field__error";
  const { customError, valueMissing } = field.validity;
  const needed = field.type === "checkbox" ? unticked : valueMissing ? missing : field.dataset.malformed;
  refusal.textContent = (customError ? field.validationMessage : needed) ?? "";
  refusals.set(field, refusal);
  (field.closest(".check") ?? field).after(refusal);
  // The buttons of a review lie over what is at its foot.
  if (isFirst && field.closest("dialog")) refusal.scrollIntoView({ block: "center" });
  field.setAttribute("aria-invalid", "true");
  field.ariaDescription = refusal.textContent;
}

/** @param {Event} event */
function accept(event) {
  const target = /** @type {HTMLInputElement} */ (event.target);
  if (!refusals.has(target)) return;
  refusals.get(target)?.remove();
  refusals.delete(target);
  target.removeAttribute("aria-invalid");
  target.ariaDescription = null;
}

export function start() {
  followFiles();
  document.addEventListener("invalid", refuse, { capture: true });
  document.addEventListener("input", accept);
}
