// Lets all marks of active alarms that are not acknowledged blink together: two changes of style a second for the
// page. An animation for each mark costs a layer each, and every drawing of a page with many marks pays for them.
const HALF_MS = 500;

export function start() {
  setInterval(() => document.documentElement.toggleAttribute("data-blink"), HALF_MS);
}
