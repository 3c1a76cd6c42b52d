// How the curves of a chart differ.
import assert from "node:assert/strict";
import { test } from "node:test";
import { openPage } from "./page.js";

openPage();
const { isBit, look } = await import("../../static/js/trends-plot.js");

test("32 curves differ in hue or dash", () => {
  const looks = Array.from({ length: 32 }, (_, place) => JSON.stringify(look(place)));
  assert.equal(new Set(looks).size, 32);
  assert.deepEqual(look(32), look(0));
});

test("speeds and the analog input are curves, everything else is a bit", () => {
  const values = ["commanded", "actual", "analog", "run", "estop"];
  assert.deepEqual(values.map((value) => isBit({ value })), [false, false, false, true, true]);
});
