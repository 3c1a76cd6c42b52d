// What jams on an open page, in words: `() => string[]`. A control may not lie on another one or on a text, be cut by
// what it is in, or be too small so near to another one that a finger meets both.
() => {
  const [SLACK_PX, SMALL_PX, NEAR_PX] = [2, 24, 8];
  /** Keys and choices of one kind have one border between them. */
  const GROUPED = ".pad, .tabs, .views, .nudges";
  const CONTROLS = "a[href], button, input:not([type=hidden]), select, textarea, summary";
  const shown = (element) =>
    element.checkVisibility({ visibilityProperty: true, opacityProperty: true }) && !element.closest("[inert], .visually-hidden");
  const isThere = ({ width, height }) => width > 1 && height > 1;
  const nameOf = (element) => {
    const text = (element.ariaLabel || element.textContent || element.name || "").trim().replace(/\s+/g, " ");
    return `${element.tagName.toLowerCase()}${element.className ? `.${String(element.className).split(" ")[0]}` : ""} "${text.slice(0, 40)}"`;
  };
  /** What stays in the window while the page is scrolled lies over it on purpose. */
  const layerOf = (element) => {
    for (let at = element; at; at = at.parentElement)
      if (["fixed", "sticky"].includes(getComputedStyle(at).position)) return at;
    return null;
  };
  /** The part of a box that its scrolling and cutting surroundings show. */
  const seen = (element, box) => {
    let { left, top, right, bottom } = box;
    for (let at = element; at && at !== document.body; at = at.parentElement) {
      const { overflowX, overflowY, position } = getComputedStyle(at);
      if (overflowX !== "visible" || overflowY !== "visible") {
        const clip = at.getBoundingClientRect();
        [left, right] = [Math.max(left, clip.left), Math.min(right, clip.right)];
        [top, bottom] = [Math.max(top, clip.top), Math.min(bottom, clip.bottom)];
      }
      if (position === "fixed") break;
    }
    return { left, top, right, bottom, width: right - left, height: bottom - top };
  };
  /** How much more than its box of a control is pressed: what it draws around itself, as a tile's mark does. */
  const around = (element) => {
    const { content, position, top } = getComputedStyle(element, "::after");
    return content !== "none" && position === "absolute" ? Math.max(0, -2 * Number.parseFloat(top)) : 0;
  };
  const both = (a, b) => [Math.min(a.right, b.right) - Math.max(a.left, b.left), Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top)];
  const overlap = (a, b) => both(a, b).every((px) => px > SLACK_PX);
  /** A link within a sentence is as high as its line, and where it is broken its box has the next one in it. */
  const isInline = (element) => getComputedStyle(element).display === "inline";
  const related = (a, b) =>
    a.contains(b) || b.contains(a) || (isInline(a) && isInline(b) && a.parentElement === b.parentElement);

  const controls = [...document.querySelectorAll(CONTROLS)].filter(shown).map((element) => {
    const whole = element.getBoundingClientRect();
    return { element, whole, box: seen(element.parentElement, whole), layer: layerOf(element) };
  }).filter(({ whole, box }) => isThere(whole) && isThere(box));
  const texts = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const { parentElement: element, textContent } = walker.currentNode;
    if (!textContent.trim() || !shown(element)) continue;
    const range = document.createRange();
    range.selectNodeContents(walker.currentNode);
    for (const rect of range.getClientRects()) {
      const box = seen(element, rect);
      if (isThere(box)) texts.push({ element, box, layer: layerOf(element) });
    }
  }
  const found = new Set();
  controls.forEach(({ element, box, whole, layer }, at) => {
    for (const other of controls.slice(at + 1)) {
      if (related(element, other.element) || layer !== other.layer) continue;
      if (overlap(box, other.box)) found.add(`${nameOf(element)} lies on ${nameOf(other.element)}`);
      const [x, y] = both(box, other.box);
      const small = [[element, whole], [other.element, other.whole]].some(
        ([one, { width, height }]) => !isInline(one) && Math.min(width, height) + around(one) < SMALL_PX && !one.closest("label"),
      );
      const buttons =
        element.parentElement === other.element.parentElement &&
        [element, other.element].every((one) => one.matches(".button") && !one.closest(GROUPED));
      if ((small || buttons) && Math.min(x, y) > -NEAR_PX && Math.max(x, y) > 0 && !isInline(element) && !isInline(other.element))
        found.add(`${nameOf(element)} is too near to ${nameOf(other.element)}`);
    }
    // The present value stands in an empty field, and is not pressed.
    const isHint = (text) => element.matches(":placeholder-shown") && getComputedStyle(text).pointerEvents === "none";
    for (const text of texts)
      if (!related(element, text.element) && !isHint(text.element) && layer === text.layer && overlap(box, text.box))
        found.add(`${nameOf(element)} lies on the text ${nameOf(text.element)}`);
    for (let up = element.parentElement; up && up !== document.body; up = up.parentElement) {
      const { overflowX, overflowY } = getComputedStyle(up);
      const clip = up.getBoundingClientRect();
      const isCut = (how, before, after) => ["hidden", "clip"].includes(how) && Math.max(before, after) > SLACK_PX;
      if (isCut(overflowX, clip.left - whole.left, whole.right - clip.right) || isCut(overflowY, clip.top - whole.top, whole.bottom - clip.bottom))
        found.add(`${nameOf(element)} is cut by ${nameOf(up)}`);
      if (["auto", "scroll"].includes(overflowX) || ["auto", "scroll"].includes(overflowY)) break;
    }
    if (element.matches("button, .button") && element.scrollWidth > element.clientWidth + SLACK_PX)
      found.add(`${nameOf(element)} is wider than its button`);
  });
  return [...found];
}
