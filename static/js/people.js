// Who else has a page open, and that control of a line went from one to another.
import { listen } from "./bind.js";

function draw(here) {
  for (const list of document.querySelectorAll("[data-people]")) {
    const items = here
      .split("\n")
      .filter(Boolean)
      .map((line) => {
        const [name, role] = line.split("\t");
        const item = document.createElement("li");
        item.textContent = `${name} · ${role}`;
        return item;
      });
    list.replaceChildren(...items);
  }
}

export function start() {
  listen("people", (fields) => draw(fields.here ?? ""));
  for (const part of document.querySelectorAll("[data-control]")) {
    listen(part.dataset.control, (fields, changed) => {
      // The first word of an opened page is no change; what came since it was drawn is.
      if ("held_by" in changed && fields.held_by !== part.dataset.heldBy) {
        part.dataset.heldBy = fields.held_by;
        document.dispatchEvent(new CustomEvent(`lineside:control-${part.dataset.control}`));
      }
    });
  }
}
