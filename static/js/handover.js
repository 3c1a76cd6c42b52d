// Pictures of a note are made small enough before they are sent. Drawn again, they have no metadata and are upright.
// A time outside its shift, or after now, is refused at its field: the server would take the page away.
import "./main.js";

const LONGEST_SIDE = 1600;
const QUALITY = 0.8;
const DAY = 1440;
const MINUTE_MS = 60_000;
const input = document.querySelector("[data-pictures]");

/** @param {File} file */
async function reduced(file) {
  const bitmap = await createImageBitmap(file);
  const scale = Math.min(1, LONGEST_SIDE / Math.max(bitmap.width, bitmap.height));
  const canvas = document.createElement("canvas");
  canvas.width = Math.round(bitmap.width * scale);
  canvas.height = Math.round(bitmap.height * scale);
  canvas.getContext("2d")?.drawImage(bitmap, 0, 0, canvas.width, canvas.height);
  const blob = await new Promise((done) => canvas.toBlob(done, "image/jpeg", QUALITY));
  return new File([blob], "picture.jpg", { type: "image/jpeg" });
}

// A file that the browser cannot draw is sent as it is: the server refuses it and gives the reason.
input?.addEventListener("change", async () => {
  const button = /** @type {HTMLFormElement} */ (input.form).querySelector("[type=submit]");
  const drawn = new DataTransfer();
  button.disabled = true;
  try {
    for (const file of input.files ?? []) drawn.items.add(await reduced(file).catch(() => file));
    input.files = drawn.files;
  } finally {
    button.disabled = false;
  }
});

const clock = /** @type {HTMLInputElement | null} */ (document.querySelector("[data-outside]"));
const minutesOf = (/** @type {string} */ text) => Number(text.split(":")[0]) * 60 + Number(text.split(":")[1]);

clock?.addEventListener("input", () => {
  const { start = "", minutes, outside = "" } = clock.dataset;
  const sinceStart = (minutesOf(clock.value) - minutesOf(start) + DAY) % DAY;
  clock.setCustomValidity(sinceStart > Number(minutes) + performance.now() / MINUTE_MS ? outside : "");
});
