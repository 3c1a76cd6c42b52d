// What tests/e2e/test_double_tap.py runs in each page: the time, which buttons there are, and what a page takes for a
// press.
(() => {
  const LATER = "test-later";
  const PRESSES = "test-presses";
  const PRESSED = "button:not([data-pad], [data-keypad-next]), input[type=submit], a[hx-get], a[hx-post]";
  const GOES_ON = "[data-review-act], [data-undo] button";
  const stored = (name) => Number(sessionStorage.getItem(name) ?? 0);

  const { timeOrigin } = performance;
  Object.defineProperty(performance, "timeOrigin", { get: () => timeOrigin + stored(LATER) });
  // Behind the rule of second-tap.js, before what a button does.
  document.addEventListener(
    "click",
    (event) => {
      if (event.isTrusted && event.target.closest?.(PRESSED)) sessionStorage.setItem(PRESSES, stored(PRESSES) + 1);
    },
    { capture: true },
  );

  /** Let a second pass. */
  const later = () => {
    sessionStorage.setItem(LATER, stored(LATER) + 1000);
    sessionStorage.setItem(PRESSES, 0);
  };

  /** Whether the page shows every response, in the next frame but one, and takes an answer to a request. */
  const isAtRest = async () => {
    await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
    return !document.querySelector(".htmx-request, .htmx-swapping, .htmx-settling, [data-pending], [data-requested] [inert]");
  };

  const type = (field, text) => {
    field.value = text;
    field.dispatchEvent(new Event("input", { bubbles: true }));
  };

  const canBePressed = (button) =>
    button.checkVisibility({ visibilityProperty: true }) &&
    !button.disabled &&
    !button.closest("[inert]") &&
    (!document.querySelector("dialog[open]") || button.closest("dialog[open]"));

  /** What a button does, without the number of its unit or row. */
  const kindOf = (button) => {
    const { form } = button;
    const attribute = (name) => button.getAttribute(name) ?? "";
    const sends =
      button.type === "submit" && form
        ? (form.getAttribute("hx-post") ??
          `${form.method} ${button.getAttribute("formaction") ?? form.getAttribute("action")}`)
        : attribute("hx-post") || attribute("hx-get");
    const parts = [sends, attribute("hx-vals"), button.name, button.value, button.ariaLabel || button.textContent];
    const text = parts.filter(Boolean).join(" | ");
    return text.replace(/[0-9a-f]{12,}|\d+([.,:]\d+)*/g, "#").trim().replace(/\s+/g, " ");
  };

  const rankOf = (button) => {
    if (button.matches(GOES_ON)) return 0;
    return button.matches("[data-review-cancel]") ? 2 : 1;
  };

  /** The kind of each button that can be pressed now; those that go on with what is open come first. */
  const buttons = () => {
    for (const each of document.querySelectorAll("[data-test-button]")) delete each.dataset.testButton;
    for (const each of document.querySelectorAll("main details")) each.open = true;
    // A drawer that the page has is part of the page; what another page fills stays a drawer.
    for (const each of document.querySelectorAll("main .drawer:not(#edit)")) {
      each.popover = null;
      each.style.position = "static";
    }
    for (const each of document.querySelectorAll("[data-typed]")) type(each, each.dataset.typed);
    return [...document.querySelectorAll(PRESSED)]
      .filter(canBePressed)
      .sort((one, other) => rankOf(one) - rankOf(other))
      .map((button, number) => {
        button.dataset.testButton = number;
        return kindOf(button);
      });
  };

  /** Fill in one field of a form with something that can be sent. */
  const fill = (field, password) => {
    if (field.disabled || field.readOnly || !field.checkVisibility()) return;
    const { inputMode, type: kind, value } = field;
    if (inputMode === "decimal" || field.id === "setpoint") type(field, value === "90" ? "91" : "90");
    else if (kind === "checkbox") field.checked ||= field.required || field.name === "confirm";
    else if (kind === "password") type(field, password);
    else if (["text", "textarea", "search"].includes(kind) && !value)
      type(field, inputMode === "numeric" ? "1" : "tapped twice");
    if (!field.required && !field.checkValidity()) type(field, "");
  };

  /** The middle of a button whose form is filled in; null where it is covered. */
  const place = (number, password) => {
    const button = document.querySelector(`[data-test-button="${number}"]`);
    for (const field of button?.form?.elements ?? []) fill(field, password);
    button?.scrollIntoView({ block: "center", behavior: "instant" });
    const box = button?.getClientRects()[0];
    if (!box) return null;
    const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
    return button.contains(document.elementFromPoint(x, y)) ? [x, y] : null;
  };

  globalThis.walk = { later, isAtRest, buttons, place, presses: () => stored(PRESSES) };
})();
