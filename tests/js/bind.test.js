// Values as they are known: at once, whenever they are drawn.
import assert from "node:assert/strict";
import { test } from "node:test";
import { openPage } from "./page.js";

openPage();
const { draw, fieldsOf, listen, rebind, replace, show, value } = await import("../../static/js/bind.js");

test("a change adds to what is known, a snapshot replaces it", () => {
  replace({ "line/1": { actual: "1", link: "online" } });
  show({ "line/1": { actual: "2" } });
  assert.deepEqual(fieldsOf("line/1"), { actual: "2", link: "online" });
  assert.equal(value("line/1.actual"), "2");
  replace({ "line/2": { actual: "3" } });
  assert.equal(value("line/1.actual"), undefined);
});

test("a listener is given what is known at once and each change, until it leaves", () => {
  replace({ people: { count: "1" } });
  const calls = [];
  const leave = listen("people", (fields, changed) => calls.push([{ ...fields }, { ...changed }]));
  show({ people: { here: "anna" }, line: {} });
  leave();
  show({ people: { count: "2" } });
  assert.deepEqual(calls, [
    [{ count: "1" }, { count: "1" }],
    [{ count: "1", here: "anna" }, { here: "anna" }],
  ]);
});

test("only what an element shows is drawn: the time of a reading alone costs no frame", () => {
  const shown = { dataset: { live: "line/1.actual" }, textContent: "", replaceChildren() {} };
  document.querySelectorAll = (selector) => (selector === "[data-live]" ? [shown] : []);
  document.createTextNode = (data) => ({ data });
  globalThis.requestAnimationFrame = () => {};
  rebind();
  replace({ "line/1": { actual: "1", at: "0.1" } });
  const frames = [];
  globalThis.requestAnimationFrame = (act) => frames.push(act);
  show({ "line/1": { at: "0.2" } });
  assert.equal(frames.length, 0);
  show({ "line/1": { actual: "2", at: "0.3" } });
  assert.equal(frames.length, 1);
  assert.equal(draw(), false);
});

test("a text that is bound again stays in its place: a live region reads what is put in anew", () => {
  const text = { nodeType: 3, data: "5 alarms" };
  const put = [];
  const shown = {
    dataset: { live: "alarms_present.active" },
    firstChild: text,
    lastChild: text,
    replaceChildren: (each) => put.push(each),
  };
  document.querySelectorAll = (selector) => (selector === "[data-live]" ? [shown] : []);
  rebind();
  rebind();
  replace({ alarms_present: { active: "5 alarms" } });
  draw();
  assert.deepEqual(put, []);
});
