// A second tap within a second on a button that acts does nothing, also where another button has come under the finger.
import assert from "node:assert/strict";
import { test } from "node:test";

/** What was pressed: `acts` unless it is a key of the number pad, `sends` where it posts a form. */
class Element {
  constructor({ acts = true, sends = false } = {}) {
    Object.assign(this, { acts, sends, isConnected: true });
  }
  closest = () => (this.acts ? this : null);
  matches = () => this.sends;
}
globalThis.Element = Element;

/** A browser with a page; `press` tells whether the page gets the press. */
async function openBrowser({ keeps = true } = {}) {
  const kept = {};
  let listener = null;
  const fail = () => {
    throw new Error("no storage");
  };
  globalThis.sessionStorage = keeps
    ? { getItem: (key) => kept[key] ?? null, setItem: (key, text) => (kept[key] = text) }
    : { getItem: fail, setItem: fail };
  globalThis.addEventListener = (type, listen) => {
    if (type === "click") listener = listen;
  };
  const openPage = () => import(`../../static/js/second-tap.js?${Math.random()}`);
  await openPage();
  return {
    openPage,
    press(target, ms, { x = 0, y = 0, byKey = false } = {}) {
      let gets = true;
      const preventDefault = () => (gets = false);
      const pressed = { isTrusted: true, timeStamp: ms, target, clientX: x, clientY: y, detail: byKey ? 0 : 1 };
      listener({ ...pressed, preventDefault, stopImmediatePropagation() {} });
      return gets;
    },
  };
}

test("the same button acts again after a second, by a tap and by a key", async () => {
  for (const byKey of [false, true]) {
    const { press } = await openBrowser();
    const button = new Element();
    assert.ok(press(button, 0, { byKey }));
    assert.ok(!press(button, 999, { byKey }));
    assert.ok(press(button, 1000, { byKey }));
  }
});

test("another button acts at once, unless it sends something and is under the same finger", async () => {
  const { press } = await openBrowser();
  assert.ok(press(new Element(), 0));
  assert.ok(press(new Element({ sends: true }), 100, { x: 40 }));
  assert.ok(press(new Element(), 200, { x: 40 }));
  assert.ok(!press(new Element({ sends: true }), 300, { x: 60 }));
  assert.ok(press(new Element({ sends: true }), 400, { x: 60, byKey: true }));
});

test("a button that was drawn in place of the first does nothing", async () => {
  const { press } = await openBrowser();
  const first = new Element();
  press(first, 0);
  first.isConnected = false;
  assert.ok(!press(new Element(), 500));
  assert.ok(press(new Element(), 1000));
});

test("the same digit is typed twice", async () => {
  const { press } = await openBrowser();
  const digit = new Element({ acts: false });
  assert.ok(press(digit, 0));
  assert.ok(press(digit, 50));
});

test("the next page knows the tap, and a browser that keeps nothing that of this page", async () => {
  const browser = await openBrowser();
  browser.press(new Element(), 0);
  await browser.openPage();
  assert.ok(!browser.press(new Element({ sends: true }), 500));
  const { press } = await openBrowser({ keeps: false });
  const button = new Element();
  assert.ok(press(button, 0));
  assert.ok(!press(button, 500));
});

test("what closes a review that has just come under the finger is not pressed by its second tap", async () => {
  const { press } = await openBrowser();
  const cancel = new Element();
  cancel.matches = (/** @type {string} */ selector) => selector.includes("[data-review-cancel]");
  assert.ok(press(new Element({ sends: true }), 0));
  assert.ok(!press(cancel, 450));
  assert.ok(press(cancel, 1500));
});
