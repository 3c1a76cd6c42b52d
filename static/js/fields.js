// Fields that speak the language of the page and not of the browser: the chosen file, and a typed time.
import "./main.js";

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

for (const shown of document.querySelectorAll("[data-chosen]")) {
  const input = /** @type {HTMLInputElement} */ (document.getElementById(shown.dataset.chosen ?? ""));
  const none = shown.textContent;
  const show = () => {
    shown.textContent = input.files?.length ? describe(input.files) : none;
  };
  input.addEventListener("change", show);
  show(); // a page that comes back keeps its file
}

for (const input of /** @type {NodeListOf<HTMLInputElement>} */ (document.querySelectorAll("[data-malformed]")))
  input.addEventListener("input", () => {
    input.setCustomValidity("");
    input.setCustomValidity(input.validity.patternMismatch ? (input.dataset.malformed ?? "") : "");
  });
