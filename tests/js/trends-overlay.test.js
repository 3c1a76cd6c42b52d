// Where alarms are drawn over the curves of a chart, and where the names of these stand.
import assert from "node:assert/strict";
import { test } from "node:test";
import { openPage } from "./page.js";

openPage();
const { alarmRows, apart, placed } = await import("../../static/js/trends-overlay.js");

const WIDE = { chart: 1000, beside: 0 };
const alarm = (priority, t, until, place = "Nip", name = "Trip") => ({ priority, t, until, place, name });
const drawn = (alarms) => placed(alarms, [100, 200], WIDE).map(({ priority, row, x, end }) => [priority, row, x, end]);
/** Where each name begins and ends, in whole percent. */
const names = (alarms, room = WIDE) => placed(alarms, [100, 200], room).map(({ row, named }) => [row, named?.map(Math.round) ?? null]);

test("each is drawn from where it began to where it ended, within the span", () => {
  assert.deepEqual(drawn([alarm("low", 50, 120), alarm("low", 130, 140), alarm("low", 180, null)]), [
    ["low", 0, 0, 20],
    ["low", 0, 30, 40],
    ["low", 0, 80, 100],
  ]);
  assert.deepEqual(drawn([alarm("low", 50, 100), alarm("low", 200, null)]), []);
});

test("the rows are those of the priorities that occur, and a lower one is drawn over the areas of the one above", () => {
  assert.deepEqual(drawn([alarm("urgent", 110, 120), alarm("medium", 110, 120), alarm("high", 10, 20)]), [
    ["urgent", 0, 10, 20],
    ["medium", 1, 10, 20],
  ]);
});

test("two of one priority at a time have a row each, more of them share the second", () => {
  const rows = drawn([alarm("low", 110, 150), alarm("low", 120, null), alarm("low", 130, null), alarm("low", 150, 160)]);
  assert.deepEqual(rows.map(([, row, x]) => [row, x]), [[0, 20], [1, 10], [1, 30], [1, 50]]);
});

test("a name stands after its line, else before it, and never over the line or the name of another alarm", () => {
  assert.deepEqual(names([alarm("low", 150, null), alarm("high", 150, 160)]), [[0, [60, 71]], [1, [39, 50]]]);
});

test("the second of two that follow each other has a row of its own where its name has no room", () => {
  const phone = { chart: 240, beside: 34 };
  const [first, second] = [alarm("low", 130, 140, "Coater", "Not in REMOTE"), alarm("low", 165, null, "Dryer 2", "Not in REMOTE")];
  assert.deepEqual(names([first, second], phone).map(([row]) => row), [0, 1]);
  assert.ok(names([first, second], phone).every(([, name]) => name));
});

test("an active alarm is named before cleared ones, on its line where that takes the whole span", () => {
  const phone = { chart: 240, beside: 34 };
  const alarms = [alarm("urgent", 195, null, "Dryer 1"), alarm("urgent", 190, 191, "Unwind"), alarm("urgent", 185, 194, "line")];
  const [first] = placed(alarms, [100, 200], phone);
  assert.deepEqual([first.row, first.until, first.named?.[1]], [0, null, 95]);
  assert.deepEqual(names([alarm("high", 90, null)]), [[0, [0, 11]]]);
});

test("a row beside which there is room has a name, where need be cut, also where the same alarm came again", () => {
  const phone = { chart: 248, beside: 34 };
  const place = "Verzug außerhalb seines Bandes";
  const rows = names([alarm("medium", 177, 178, "Coater", place), alarm("medium", 197, 198, "Coater", place)], phone);
  assert.ok(rows.some(([, named]) => named), JSON.stringify(rows));
  assert.ok(names([alarm("high", 160, null, "Coater", place)], phone)[0][1]);
});

test("the marks of a phone take no more than four rows", () => {
  const many = ["urgent", "high", "medium", "low"].flatMap((priority) => [alarm(priority, 110, 150), alarm(priority, 120, null)]);
  assert.equal(alarmRows(many, [100, 200], { chart: 240, beside: 34 }), 4);
  assert.equal(alarmRows(many, [100, 200], WIDE), 8);
});

test("their lane has a row before the first alarm came", () => {
  assert.equal(alarmRows([], [100, 200], WIDE), 1);
  assert.equal(alarmRows([alarm("urgent", 110, 120), alarm("low", 110, null)], [100, 200], WIDE), 2);
});

test("names stand at the ends of their lines, apart where they would touch, and in their span", () => {
  assert.deepEqual(apart([50, 10], 15, [0, 100]), [50, 10]);
  assert.deepEqual(apart([50, 52, 48], 15, [0, 100]), [50, 65, 35]);
  assert.deepEqual(apart([99, 98], 15, [0, 100]), [100, 85]);
  assert.deepEqual(apart([2, 1, 80], 15, [0, 100]), [15, 0, 80]);
  assert.deepEqual(apart([], 15, [0, 100]), []);
});
