// A second tap within a second on a button that acts does nothing, also where another row, a dialog or the next page
// has come under the finger since the first. Runs before the first paint: the tap may be as early.
/** @typedef {{ at: number, x: number, y: number, isTouch: boolean }} Tap */
(() => {
  const WITHIN_MS = 1000;
  /** Less than from one button to the next. */
  const NEAR_PX = 40;
  const STORED = "lineside-last-tap";
  /** All but the keys of a number pad, on which a digit is typed twice, and what leads on through the tour. */
  const ACTS =
    "button:not([data-pad], [data-keypad-next], [data-tour-next], [data-tour-back]), input[type=submit], a:is([hx-get], [hx-post])";
  /** Which send something, or close a review that has just come under the finger: also not where another has just been
   * pressed at the same place. */
  const SENDS =
    ":is([type=submit], :not([type]), [hx-get], [hx-post], [data-sound-press], [data-review-cancel])";
  /** @type {Element | null} */
  let button = null;
  /** In a browser that keeps nothing: of this page alone.
   * @type {Tap | null} */
  let unkept = null;

  /** @returns {Tap | null} */
  function last() {
    try {
      return JSON.parse(sessionStorage.getItem(STORED) ?? "null");
    } catch {
      return unkept;
    }
  }

  /** @param {Tap} tap */
  function remember(tap) {
    try {
      sessionStorage.setItem(STORED, JSON.stringify(tap));
    } catch {
      unkept = tap;
    }
  }

  /** A key presses a button at no place.
   * @param {Tap} tap @param {Tap} before */
  const isNear = (tap, before) =>
    tap.isTouch && before.isTouch && Math.hypot(tap.x - before.x, tap.y - before.y) < NEAR_PX;

  /** What was pressed is there no more: another is under the finger.
   * @param {Element | null} pressed */
  const isGone = (pressed) => pressed !== null && !pressed.isConnected;

  /** @param {Tap} tap @param {Tap} before */
  const isSoon = (tap, before) => tap.at >= before.at && tap.at - before.at < WITHIN_MS;

  /** @param {Element} acting @param {Tap} tap @param {Tap} before */
  const isSecond = (acting, tap, before) =>
    isSoon(tap, before) &&
    (acting === button || (isNear(tap, before) && (acting.matches(SENDS) || isGone(button))));

  addEventListener(
    "click",
    (event) => {
      // A script presses what a person pressed before it was there.
      if (!event.isTrusted) return;
      const acting = event.target instanceof Element ? event.target.closest(ACTS) : null;
      // When the finger was there: a busy page gets the tap later.
      const at = performance.timeOrigin + event.timeStamp;
      const tap = { at, x: event.clientX, y: event.clientY, isTouch: event.detail > 0 };
      const before = last();
      if (acting && before && isSecond(acting, tap, before)) {
        event.preventDefault();
        event.stopImmediatePropagation();
        return;
      }
      button = acting;
      remember(tap);
    },
    { capture: true },
  );

  // A key that is held down presses once.
  addEventListener(
    "keydown",
    (event) => {
      const isRepeated = event.repeat && (event.key === "Enter" || event.key === " ");
      if (isRepeated && event.target instanceof Element && event.target.matches(`${ACTS}, input, select`))
        event.preventDefault();
    },
    { capture: true },
  );
})();
