// The page of a bus: who else has a page open, and the live frames while the user follows them.
import { listen } from "./bind.js";
import { zone } from "./clock.js";
import { follow } from "./live.js";
import { language } from "./words.js";

const MAX_LINES = 400;
/** The frames of a busy bus, a hundred a second, are written together: each writing costs a style of the page. */
const WRITE_MS = 250;
/** @type {Frame[]} */
let unwritten = [];
const time = new Intl.DateTimeFormat(language, {
  hour: "2-digit",
  minute: "2-digit",
  second: "2-digit",
  fractionalSecondDigits: 3,
  hourCycle: "h23",
  timeZone: zone,
});

/** @param {string} text */
function cell(text) {
  const span = document.createElement("span");
  span.textContent = text;
  return span;
}

/** @param {Frame} frame */
function line(frame) {
  const row = document.createElement("div");
  row.className = "frames__line";
  if (!frame.valid) row.dataset.valid = "no";
  row.append(
    cell(time.format(frame.at * 1000)),
    cell(frame.direction === "out" ? "→" : "←"),
    cell(frame.hex),
    cell(frame.meaning),
  );
  return row;
}

/** @param {HTMLElement} box @param {Frame[]} frames */
function take(box, frames) {
  if (!unwritten.length) setTimeout(write, WRITE_MS, box);
  unwritten = [...unwritten, ...frames].slice(-MAX_LINES);
}

/** @param {HTMLElement} box */
function write(box) {
  const atEnd = box.scrollHeight - box.scrollTop - box.clientHeight < 40;
  box.append(...unwritten.map(line));
  unwritten = [];
  while (box.childElementCount > MAX_LINES) box.firstElementChild?.remove();
  if (atEnd) box.scrollTop = box.scrollHeight;
}

/** @param {Person[]} here */
function drawPeople(here) {
  for (const list of document.querySelectorAll("[data-people]")) {
    const items = here.map(([name, role]) => {
      const item = document.createElement("li");
      item.textContent = `${name} · ${role}`;
      return item;
    });
    list.replaceChildren(...items);
  }
}

function followPeople() {
  listen("people", (fields) => {
    drawPeople(fields.here ?? []);
    document.dispatchEvent(new CustomEvent("lineside:people"));
  });
}

export function start() {
  followPeople();
  const button = document.querySelector("[data-trace]");
  const box = document.querySelector("[data-frames]");
  if (!button) return;
  button.addEventListener("click", () => {
    const on = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(on));
    button.textContent = on ? button.dataset.wordOn : button.dataset.wordOff;
    if (on) follow([], button.dataset.trace, (frames) => take(box, frames));
    else follow([]);
  });
}
