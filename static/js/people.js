// Who else has a page open.
import { listen } from "./bind.js";

/** @param {string} what */
const notify = (what) => document.dispatchEvent(new CustomEvent(what));

/** @param {Person[]} here */
function draw(here) {
  for (const list of document.querySelectorAll("[data-people]")) {
    const items = here.map(([name, role]) => {
      const item = document.createElement("li");
      item.textContent = `${name} · ${role}`;
      return item;
    });
    list.replaceChildren(...items);
  }
}

export function start() {
  listen("people", (fields) => {
    draw(fields.here ?? []);
    notify("lineside:people");
  });
}
