// A second tap within a second on a button that acts does nothing, also where another row, a dialog or the next page
// has come under the finger since the first. Runs before the first paint: the tap may be as early.
(() => {
  const WITHIN_MS = 1000;
  /** Less than from one button to the next. */
  const NEAR_PX = 40;
  const STORED = "lineside-last-tap";
  const ACTS =
    "button:is([type=submit], :not([type]), [hx-get], [hx-post], [data-sound-press]), input[type=submit]";
  let button = null;
  let last = read();

  function read() {
    try {
      return JSON.parse(sessionStorage.getItem(STORED));
    } catch {
      return null;
    }
  }

  function remember(tap) {
    last = tap;
    try {
      sessionStorage.setItem(STORED, JSON.stringify(tap));
    } catch {
      // A browser that keeps nothing knows the taps of this page.
    }
  }

  /** A key presses a button at no place. */
  const isNear = (tap) =>
    tap.isTouch && last.isTouch && Math.hypot(tap.x - last.x, tap.y - last.y) < NEAR_PX;

  const isSoon = (tap) => last !== null && tap.at >= last.at && tap.at - last.at < WITHIN_MS;

  addEventListener(
    "click",
    (event) => {
      // A script presses what a person pressed before it was there.
      if (!event.isTrusted) return;
      const acting = event.target.closest?.(ACTS) ?? null;
      const tap = { at: Date.now(), x: event.clientX, y: event.clientY, isTouch: event.detail > 0 };
      if (acting && isSoon(tap) && (acting === button || isNear(tap))) {
        event.preventDefault();
        event.stopImmediatePropagation();
        return;
      }
      button = acting;
      remember(tap);
    },
    { capture: true },
  );
})();
