// Makes elements of the page.

/** @template {keyof HTMLElementTagNameMap} T @param {T} tag @param {Record<string, unknown>} properties
 * @param {Record<string, string>} data of its dataset @param {(string | Node)[]} children @returns {HTMLElementTagNameMap[T]} */
export function element(tag, properties = {}, data = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  Object.assign(made.dataset, data);
  made.append(...children);
  return made;
}

/** Draw what is in an element again, and give the focus back to the button with the same data-key, else to `otherwise`.
 * @param {HTMLElement} of @param {Node[]} content @param {() => HTMLElement | null | undefined} [otherwise] */
export function refill(of, content, otherwise) {
  const key = of.contains(document.activeElement) ? /** @type {HTMLElement} */ (document.activeElement).dataset.key : undefined;
  of.replaceChildren(...content);
  if (key === undefined) return;
  const same = [...of.querySelectorAll("button")].find(({ dataset }) => dataset.key === key);
  (same ?? otherwise?.())?.focus();
}

/** Bring words into the window that something hides or that are outside it. Words that are seen move nothing: who presses
 * again presses the same.
 * @param {Element | null | undefined} words */
export function reveal(words) {
  if (!words) return;
  const { left, top, bottom } = (words.firstElementChild ?? words).getBoundingClientRect();
  const isSeen = [top, bottom].every((y, end) => words.contains(document.elementFromPoint(left + 2, end ? y - 2 : y + 2)));
  if (!isSeen) words.scrollIntoView({ block: "nearest" });
}
