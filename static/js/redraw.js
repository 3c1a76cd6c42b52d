// Parts of a page that the server draws are drawn anew when the value that they are made from has changed.
//   data-redraw="GROUP.FIELD" data-drawn-of="what it was when the part was drawn" hx-trigger="lineside:redraw"
import { listen } from "./bind.js";

function follow(part) {
  const key = part.dataset.redraw;
  const dot = key.indexOf(".");
  const field = key.slice(dot + 1);
  listen(key.slice(0, dot), (fields) => {
    const present = fields[field] ?? "";
    if (part.dataset.drawnOf === present) return;
    part.dataset.drawnOf = present;
    part.dispatchEvent(new CustomEvent("lineside:redraw"));
  });
}

export function start() {
  for (const part of document.querySelectorAll("[data-redraw]")) follow(part);
}
