// Where alarms are drawn over the curves of a chart, and where the names of these stand.
import assert from "node:assert/strict";
import { test } from "node:test";
import { openPage } from "./page.js";

openPage();
const { alarmRows, apart, placed } = await import("../../static/js/trends-overlay.js");

const alarm = (priority, t, until) => ({ priority, t, until });
const drawn = (alarms) => placed(alarms, [100, 200]).map(({ priority, row, x, end, room }) => [priority, row, x, end, room]);

test("each is drawn from where it began to where it ended, within the span", () => {
  assert.deepEqual(drawn([alarm("low", 50, 120), alarm("low", 130, 140), alarm("low", 180, null)]), [
    ["low", 0, 0, 20, 10],
    ["low", 0, 30, 40, 40],
    ["low", 0, 80, 100, 0],
  ]);
  const [first, second] = placed([alarm("low", 130, 140), alarm("low", 180, null)], [100, 200]);
  assert.deepEqual([first?.before, second?.before], [30, 40]);
  assert.deepEqual(drawn([alarm("low", 50, 100), alarm("low", 200, null)]), []);
});

test("the rows are those of the priorities that occur, and a lower one is drawn over the areas of the one above", () => {
  assert.deepEqual(drawn([alarm("urgent", 110, 120), alarm("medium", 110, 120), alarm("high", 10, 20)]), [
    ["urgent", 0, 10, 20, 80],
    ["medium", 1, 10, 20, 80],
  ]);
});

test("two of one priority at a time have a row each, more of them share the second", () => {
  const rows = drawn([alarm("low", 110, 150), alarm("low", 120, null), alarm("low", 130, null), alarm("low", 150, 160)]);
  assert.deepEqual(rows.map(([, row, x]) => [row, x]), [[0, 10], [0, 50], [1, 20], [1, 30]]);
});

test("their lane has a row before the first alarm came", () => {
  assert.equal(alarmRows([], [100, 200]), 1);
  assert.equal(alarmRows([alarm("urgent", 110, 120), alarm("low", 110, null)], [100, 200]), 2);
});

test("names stand at the ends of their lines, apart where they would touch, and in their span", () => {
  assert.deepEqual(apart([50, 10], 15, [0, 100]), [50, 10]);
  assert.deepEqual(apart([50, 52, 48], 15, [0, 100]), [50, 65, 35]);
  assert.deepEqual(apart([99, 98], 15, [0, 100]), [100, 85]);
  assert.deepEqual(apart([2, 1, 80], 15, [0, 100]), [15, 0, 80]);
  assert.deepEqual(apart([], 15, [0, 100]), []);
});
