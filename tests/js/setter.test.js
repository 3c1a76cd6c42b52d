// The number that a person typed.
import assert from "node:assert/strict";
import { test } from "node:test";
import { openPage } from "./page.js";

openPage({ language: "de" });
const { amountOf, changed, numberOf } = await import("../../static/js/setter.js");

test("a number has a comma or a point, and any sign that a keyboard has", () => {
  const typed = ["99,5", " 92.5 ", "-3", "−3", "–3", "+4", "007"];
  assert.deepEqual(typed.map(numberOf), [99.5, 92.5, -3, -3, -3, 4, 7]);
});

test("empty is not zero, and what is half a number is none", () => {
  for (const text of ["", " ", "x", "1,", ".5", "1.2.3", "1,234.5", "1e3", "0x10", "Infinity", "1 2"])
    assert.ok(Number.isNaN(numberOf(text)), text);
});

test("a tool changes the setpoint that the server sends as a number, not its text", () => {
  assert.equal(changed("scale", [1234, 1], 50), "61,7");
  assert.equal(changed("offset", [12000, 0], -0.4), "12000");
  assert.equal(changed("offset", [9995, 2], 0.1), "100,05");
});

test("percent are of the unit's own setpoint, and with a sign a change of it", () => {
  const amounts = ["105", "+5", "-5", "−2,5", "50"].map((text) => amountOf("scale", text));
  assert.deepEqual(amounts, [105, 105, 95, 97.5, 50]);
  assert.equal(amountOf("offset", "-5"), -5);
  assert.deepEqual([[1200, 1], [600, 1]].map((own) => changed("scale", own, 105)), ["126,0", "63,0"]);
});

test("a setpoint or decimals that are not known change nothing", () => {
  for (const setpoint of [undefined, [null, null], [100, null]]) assert.equal(changed("scale", setpoint, 50), null);
});
