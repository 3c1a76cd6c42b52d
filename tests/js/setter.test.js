// The number that a person typed.
import assert from "node:assert/strict";
import { test } from "node:test";
import { openPage } from "./page.js";

openPage();
const { numberOf } = await import("../../static/js/setter.js");

test("a number has a comma or a point, and any sign that a keyboard has", () => {
  const typed = ["99,5", " 92.5 ", "-3", "−3", "–3", "+4", "007"];
  assert.deepEqual(typed.map(numberOf), [99.5, 92.5, -3, -3, -3, 4, 7]);
});

test("empty is not zero, and what is half a number is none", () => {
  for (const text of ["", " ", "x", "1,", ".5", "1.2.3", "1,234.5", "1e3", "0x10", "Infinity", "1 2"])
    assert.ok(Number.isNaN(numberOf(text)), text);
});
