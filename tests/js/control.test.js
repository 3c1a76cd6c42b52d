// A request for control moves the page below it: a press that was on its way does nothing there.
import assert from "node:assert/strict";
import { test } from "node:test";
import { openPage } from "./page.js";

globalThis.Element = class {
  constructor(isOfPage) {
    this.isOfPage = isOfPage;
  }
  closest() {
    return this.isOfPage ? this : null;
  }
};

/** A page with the script: `request` is what its head shows, `click` returns whether a press was taken. */
async function openWithControl() {
  const clock = openPage();
  const listeners = {};
  let box = null;
  Object.assign(document, {
    addEventListener: (type, listener) => (listeners[type] = listener),
    querySelector: (selector) => (selector === "[data-requested]" ? box : null),
  });
  let aimed;
  globalThis.addEventListener = (_type, listener) => (aimed = listener);
  globalThis.setTimeout = () => 0;
  const { start } = await import(`../../static/js/control.js?${clock.ms}${Math.random()}`);
  start();
  return {
    clock,
    request(name) {
      box = name ? { dataset: { requested: name }, lastElementChild: {} } : null;
      listeners["htmx:after:swap"]({});
    },
    click(isOfPage = true, detail = 1) {
      let isTaken = true;
      const stop = () => (isTaken = false);
      const target = new Element(isOfPage);
      aimed({ isTrusted: true, detail, target, preventDefault: stop, stopImmediatePropagation: stop });
      return isTaken;
    },
  };
}

test("for half a second after a request has come or gone, a finger presses nothing of the page that moved", async () => {
  const page = await openWithControl();
  page.clock.ms = 10_000;
  assert.ok(page.click());
  for (const name of ["line ann 1", ""]) {
    page.request(name);
    page.clock.ms += 400;
    assert.ok(!page.click());
    page.clock.ms += 100;
    assert.ok(page.click());
  }
});

test("a key, the head, and a response without another request are as always", async () => {
  const page = await openWithControl();
  page.clock.ms = 10_000;
  page.request("line ann 1");
  assert.ok(page.click(true, 0));
  assert.ok(page.click(false));
  page.clock.ms += 600;
  page.request("line ann 1");
  assert.ok(page.click());
});
