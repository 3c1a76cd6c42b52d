// A request for control lies over the page: a finger that was on its way presses nothing below it.
import assert from "node:assert/strict";
import { test } from "node:test";
import { openPage } from "./page.js";

/** A page with the script: `request` is what its head shows. */
async function openWithControl() {
  openPage();
  const listeners = {};
  const timers = [];
  const main = { style: { pointerEvents: "" } };
  let box = null;
  Object.assign(document, {
    addEventListener: (type, listener) => (listeners[type] = listener),
    querySelector: (selector) => ({ "[data-requested]": box, ".main": main })[selector] ?? null,
  });
  globalThis.setTimeout = (act, ms) => timers.push({ act, ms });
  const { start } = await import(`../../static/js/control.js?${Math.random()}`);
  start();
  return {
    takesPresses: () => main.style.pointerEvents === "",
    request(name) {
      box = name ? { dataset: { requested: name }, lastElementChild: {} } : null;
      listeners["htmx:after:swap"]({});
    },
    wait(ms) {
      for (const timer of timers.splice(0)) if (timer.ms <= ms) timer.act();
    },
  };
}

test("for half a second after a request has come or gone, a finger presses nothing of the page below it", async () => {
  const page = await openWithControl();
  assert.ok(page.takesPresses());
  for (const name of ["line ann 1", ""]) {
    page.request(name);
    assert.ok(!page.takesPresses());
    page.wait(500);
    assert.ok(page.takesPresses());
  }
});

test("a response without another request takes no press", async () => {
  const page = await openWithControl();
  page.request("line ann 1");
  page.wait(1000);
  page.request("line ann 1");
  assert.ok(page.takesPresses());
});
