// How the lines of a chart differ, and what of them is a dot.
import assert from "node:assert/strict";
import { test } from "node:test";
import { openPage } from "./page.js";

openPage();
const { isBit, look } = await import("../../static/js/trends-values.js");
const { alone } = await import("../../static/js/trends-plot.js");
const { lastValue } = await import("../../static/js/trends-data.js");

test("32 lines differ in hue or dash, eight in both", () => {
  const looks = Array.from({ length: 32 }, (_, place) => look(place));
  assert.equal(new Set(looks.map((each) => JSON.stringify(each))).size, 32);
  for (const part of ["name", "dash"])
    assert.equal(new Set(looks.slice(0, 8).map((each) => JSON.stringify(each[part]))).size, 8);
  assert.deepEqual(look(32), look(0));
});

test("what is commanded is dashed in every place, and differs from its neighbors", () => {
  for (let place = 0; place < 32; place++) assert.ok(look(place, "commanded").dash.length > 0);
  const dashes = Array.from({ length: 8 }, (_, place) => JSON.stringify(look(place, "commanded").dash));
  assert.equal(new Set(dashes).size, 8);
});

test("speeds, draw and the analog input are curves, everything else is a bit", () => {
  const values = ["commanded", "actual", "analog", "draw", "run", "estop"];
  assert.deepEqual(values.map((value) => isBit({ value })), [false, false, false, false, true, true]);
});

test("a line ends at its last value within the span", () => {
  const line = { t: [1, 2, 3], avg: [7, 8, null] };
  assert.deepEqual([[0, 9], [0, 1], [3, 9]].map((span) => lastValue(line, span)), [8, 7, null]);
});

test("a value between two holes is a dot, and no other is", () => {
  assert.deepEqual(alone([1, null, 2, undefined, null, 3, undefined, 4, null, 5]), [0, 2, 9]);
  assert.deepEqual(alone([1, undefined, 2]), []);
});
