// Lets all marks of active alarms that are not acknowledged blink together: two changes of style a second for a page
// that has one. An animation for each mark costs a layer each, and every drawing of a page with many marks pays for them.
const HALF_MS = 500;
const BLINKS = '.alarm-priority[data-is$="waiting"]:not([data-is*="cleared"])';
const root = document.documentElement;

export function start() {
  setInterval(() => {
    root.toggleAttribute("data-blink", !root.hasAttribute("data-blink") && document.querySelector(BLINKS) !== null);
  }, HALF_MS);
}
