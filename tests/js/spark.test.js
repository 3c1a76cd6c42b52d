// The curve of ten minutes: as few points as show the same.
import assert from "node:assert/strict";
import { test } from "node:test";
import { openPage } from "./page.js";

openPage();
const { band, extremes, outline } = await import("../../static/js/spark.js");

const scale = { least: 0, most: 100 };
/** A value each minute, from the beginning of the span on. */
const spark = (...avg) => ({ t: avg.map((_, i) => 60 * i), avg });

test("points between equal ones are left out, and a gap stays a gap", () => {
  assert.equal(outline(spark(50, 50, 50, 50), 0, scale, false), "M0.0 50.0L180.0 50.0");
  assert.equal(outline(spark(50, 50, null, 50), 0, scale, false), "M0.0 50.0L60.0 50.0M180.0 50.0");
  assert.equal(outline(spark(50, 50, 50, 80), 0, scale, true), "M0.0 50.0L120.0 50.0L120.0 50.0L180.0 50.0L180.0 20.0");
});

test("the band around a setpoint is one area for as long as it stays", () => {
  assert.equal(band(spark(50, 50, null, 80, 80), 0, scale, 10), "M0.0 40.0H60.0V60.0H0.0ZM180.0 10.0H240.0V30.0H180.0Z");
});

test("the greatest and the least value stand at the height of each, and one alone where they would touch", () => {
  const scale = { least: 0, most: 132 };
  assert.deepEqual(extremes([null, 120, 0], scale), [{ value: 120, at: 12 / 132 }, { value: 0, at: 1 }]);
  assert.deepEqual(extremes([120, 119], scale).map(({ value }) => value), [120]);
});
