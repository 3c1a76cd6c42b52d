// A unit that is scrolled away is drawn once a second; one that is seen never waits.
import assert from "node:assert/strict";
import { test } from "node:test";
import { openPage } from "./page.js";

const clock = openPage();
const events = {};
let observe = () => {};
globalThis.IntersectionObserver = class {
  constructor(callback) {
    observe = callback;
  }
  observe() {}
};
globalThis.addEventListener = document.addEventListener = (name, act) => {
  events[name] = act;
};
document.querySelectorAll = () => [{}];
const { mayWait, start } = await import("../../static/js/visibility.js");

const drawn = { some: 0, all: 0 };
start(
  () => drawn.some++,
  () => drawn.all++,
);
const see = (unit, isIntersecting) => observe([{ target: { dataset: { unit } }, isIntersecting }]);

test("a unit that was always visible never waits", () => {
  assert.equal(mayWait("line/1"), false);
});

test("a unit that is not visible is due once a second", () => {
  for (let turn = 0; turn < 3; turn++) see(`line/${turn}`, false);
  see("line/8", false);
  const waits = [999, 1000, 1001, 1999, 2000].map((ms) => {
    clock.ms = ms;
    return mayWait("line/8");
  });
  assert.deepEqual(waits, [true, false, true, true, false]);
});

test("units that leave together are not due together", () => {
  clock.ms = 10_000;
  for (let unit = 10; unit < 14; unit++) see(`line/${unit}`, false);
  clock.ms = 10_600;
  const due = [10, 11, 12, 13].filter((unit) => !mayWait(`line/${unit}`));
  assert.deepEqual(due, [10, 11]);
});

test("a unit that becomes visible is drawn and waits no more", () => {
  const before = drawn.some;
  see("line/8", true);
  assert.equal(drawn.some, before + 1);
  assert.equal(mayWait("line/8"), false);
});

test("what scrolls, sizes or prints the page draws everything", () => {
  for (const name of ["scroll", "resize", "beforeprint", "pageshow"]) events[name]();
  assert.equal(drawn.all, 4);
});
