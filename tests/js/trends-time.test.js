// Times and spans in the zone and the language of the site, whatever those of the machine are.
import assert from "node:assert/strict";
import { test } from "node:test";
import { at, openPage } from "./page.js";

process.env.TZ = "America/New_York";
openPage({ language: "de", zone: "Europe/Berlin" });
const { formatTime } = await import("../../static/js/site-time.js");
const { axisLabels, axisNumbers, dayBefore, fromField, length, shiftAt, shortTime, toField } = await import(
  "../../static/js/trends-time.js"
);

const EIGHT_HOURS = [360, 840, 1320];
const SHIFTS = [
  // A moment, its shift; in UTC. The clocks of Berlin change on 29 March and 25 October.
  ["2026-11-20T15:30:00", ["2026-11-20T13:00:00", "2026-11-20T21:00:00"]],
  ["2026-11-20T04:59:59", ["2026-11-19T21:00:00", "2026-11-20T05:00:00"]],
  ["2026-11-20T05:00:00", ["2026-11-20T05:00:00", "2026-11-20T13:00:00"]],
  ["2026-03-29T00:30:00", ["2026-03-28T21:00:00", "2026-03-29T04:00:00"]],
  ["2026-03-29T04:00:00", ["2026-03-29T04:00:00", "2026-03-29T12:00:00"]],
  ["2026-10-25T00:30:00", ["2026-10-24T20:00:00", "2026-10-25T05:00:00"]],
];

for (const [moment, shift] of SHIFTS)
  test(`at ${moment} the shift is from ${shift.join(" to ")}`, () => {
    assert.deepEqual(shiftAt(at(moment), EIGHT_HOURS), shift.map(at));
  });

test("one start a day is one shift a day", () => {
  assert.deepEqual(shiftAt(at("2026-11-20T04:00:00"), [360]), [at("2026-11-19T05:00:00"), at("2026-11-20T05:00:00")]);
});

test("the day before is the same time of day, over a change of the clocks too", () => {
  assert.equal(dayBefore(at("2026-11-20T15:30:00")), at("2026-11-19T15:30:00"));
  assert.equal(dayBefore(at("2026-03-29T10:00:00")), at("2026-03-28T11:00:00"));
});

test("a time has its day only where that is another", () => {
  assert.equal(shortTime(at("2026-11-20T16:50:00"), at("2026-11-20T17:00:00")), "17:50");
  assert.equal(shortTime(at("2026-11-19T16:50:00"), at("2026-11-20T17:00:00")), "19. Nov., 17:50");
});

test("a field shows the wall clock of the site and is read as such", () => {
  assert.equal(toField(at("2026-07-01T10:00:00") + 0.9), "01.07.2026 12:00:00");
  assert.equal(toField(at("2026-01-01T10:00:00")), "01.01.2026 11:00:00");
  assert.equal(fromField("2026-07-01 12:00:00"), at("2026-07-01T10:00:00"));
  assert.equal(fromField(" 1.7.2026 12:00"), at("2026-07-01T10:00:00"), "as it is typed where dates have dots");
  assert.ok(Number.isNaN(fromField("yesterday")));
  assert.equal(fromField("2026-01-01T11:00"), at("2026-01-01T10:00:00"), "a browser leaves whole minutes short");
});

test("a field is read with the offset that holds then, in the hour before a change of the clocks too", () => {
  assert.equal(fromField("2026-03-29T01:30:00"), at("2026-03-29T00:30:00"));
  assert.equal(fromField("2026-10-25T01:30:00"), at("2026-10-24T23:30:00"));
});

test("labels of an axis name the day where it changes and are no finer than their distance", () => {
  const labels = (from, step) => axisLabels(null, [0, 1, 2].map((i) => at(from) + i * step), 0, 0, step);
  assert.deepEqual(labels("2026-01-01T22:00:00", 3600), ["23:00\n1. Jan.", "00:00\n2. Jan.", "01:00"]);
  assert.deepEqual(labels("2026-01-01T10:00:00", 30), ["11:00:00\n1. Jan.", "11:00:30", "11:01:00"]);
  assert.deepEqual(labels("2026-01-01T10:00:00", 0.5), ["11:00:00,000\n1. Jan.", "11:00:00,500", "11:00:01,000"]);
  assert.deepEqual(labels("2026-01-01T10:00:00", 86400), ["1. Jan.", "2. Jan.", "3. Jan."]);
  assert.deepEqual(labels("2026-01-15T10:00:00", 31 * 86400), ["Jan. 2026", "Feb. 2026", "März 2026"]);
});

test("numbers of an axis are in the language of the page, with the digits of their step", () => {
  assert.deepEqual(axisNumbers(null, [1200, 1200.5], 0, 0, 0.5), ["1200,0", "1200,5"]);
  assert.deepEqual(axisNumbers(null, [0, 1000], 0, 0, 1000), ["0", "1000"]);
});

test("a length is in the largest unit that keeps it readable", () => {
  const lengths = [0.2, 30, 119, 300, 7199, 28_800, 259_200].map(length);
  assert.deepEqual(lengths, ["0,2 s", "30 s", "119 s", "5 min", "120 min", "8 h", "3 d"]);
});

test("a moment has its date and the wall clock of the site", () => {
  assert.equal(formatTime(at("2026-01-01T10:00:00")), "01.01.2026, 11:00:00");
});
