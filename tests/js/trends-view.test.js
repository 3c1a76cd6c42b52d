// The address of the trends page has what is shown, and reopens it; and what each of its values is called.
import assert from "node:assert/strict";
import { test } from "node:test";
import { at, openPage } from "./page.js";

const NOW = at("2026-11-20T15:30:00");
openPage({ zone: "UTC", time: NOW });
const { iso } = await import("../../static/js/history-requests.js");
const { Catalogue, MAX_VALUES, View } = await import("../../static/js/trends-view.js");

const KNOWN = Array.from({ length: 40 }, (_, i) => `line/${i + 1}/actual`);
const catalogue = { has: (name) => KNOWN.includes(name), first: (count) => KNOWN.slice(0, count) };

function open(address = "") {
  openPage({ address });
  return new View(catalogue, [360, 840, 1320]);
}

test("without an address it shows the first eight values of the last hour", () => {
  const view = open();
  assert.deepEqual(view.series, KNOWN.slice(0, 8));
  assert.deepEqual(view.range(), [NOW - 3600, NOW]);
  assert.ok(view.live && view.marks);
  assert.equal(view.scale, "shared");
});

test("an address that was made is read back", () => {
  const view = open("?s=line/3/actual&span=600");
  view.add("line/5/actual");
  view.change({ scale: "own", marks: false, a: NOW - 20, b: NOW - 10 });
  view.show(NOW - 100, NOW - 50);
  const again = open(location.search);
  for (const name of ["series", "scale", "marks", "a", "b", "from", "to"]) assert.deepEqual(again[name], view[name]);
  view.follow(300);
  assert.deepEqual(open(location.search).range(), [NOW - 300, NOW]);
});

test("an address that is nonsense is taken for as little", () => {
  const view = open("?s=line/99/actual&span=fast&from=never&a=x&scale=huge");
  assert.deepEqual([view.series, view.span, view.from, view.a, view.scale], [[], 3600, null, null, "shared"]);
  const backwards = open(`?s=&from=${iso(NOW)}&to=${iso(NOW - 10)}`);
  assert.deepEqual([backwards.from, backwards.to], [null, null]);
  assert.equal(open("?span=0.001").span, 1);
  assert.equal(open("?span=9e99").span, 12 * 365 * 86400);
});

test("an end without a beginning shows the span before it", () => {
  assert.deepEqual(open(`?span=60&to=${iso(NOW)}`).range(), [NOW - 60, NOW]);
});

test("a view that has no value any more stays empty", () => {
  const view = open("?s=line/1/actual");
  view.remove("line/1/actual");
  assert.deepEqual(open(location.search).series, []);
});

test("no more values than can be distinguished, and none twice", () => {
  const view = open(`?${KNOWN.map((name) => `s=${name}`).join("&")}`);
  assert.equal(view.series.length, MAX_VALUES);
  view.add("line/40/actual");
  assert.equal(view.series.length, MAX_VALUES);
  const one = open("?s=line/1/actual");
  one.add("line/1/actual");
  assert.deepEqual(one.series, ["line/1/actual"]);
});

test("while it follows now, zooming changes the span and it goes on following", () => {
  const view = open("?span=600");
  view.zoom(0.5);
  assert.deepEqual([view.span, view.live], [300, true]);
  view.zoom(0.5, NOW - 100);
  assert.deepEqual([view.from, view.to], [NOW - 200, NOW - 50], "around a time it stands still");
  view.zoom(2);
  assert.deepEqual(view.range(), [NOW - 275, NOW + 25], "around the middle");
});

test("it moves by a part of its span, and past now it follows now again", () => {
  const view = open("?span=600");
  view.pan(-0.5);
  assert.deepEqual(view.range(), [NOW - 900, NOW - 300]);
  view.pan(0.25);
  assert.deepEqual(view.range(), [NOW - 750, NOW - 150]);
  view.pan(0.25);
  assert.deepEqual([view.live, view.span], [true, 600]);
});

test("it is stopped and started where it is", () => {
  const view = open("?span=600");
  view.toggleLive();
  assert.deepEqual([view.live, view.range()], [false, [NOW - 600, NOW]]);
  view.toggleLive();
  assert.deepEqual([view.live, view.span], [true, 600]);
});

test("no span is shorter than a second or longer than twelve years", () => {
  const view = open();
  view.show(NOW, NOW + 0.1);
  assert.deepEqual(view.range(), [NOW - 0.45, NOW + 0.55]);
  view.follow(1e12);
  assert.equal(view.span, 12 * 365 * 86400);
});

test("a preset is a shift of the site, and is saved as such, not as its times", () => {
  const view = open();
  view.showPreset("shift");
  assert.deepEqual(view.range(), [at("2026-11-20T14:00:00"), NOW]);
  assert.deepEqual([view.preset, view.live], ["shift", true]);
  view.showPreset("before");
  assert.deepEqual(open(location.search).range(), [at("2026-11-20T06:00:00"), at("2026-11-20T14:00:00")]);
  assert.deepEqual([view.preset, view.live], ["before", false]);
  view.zoom(0.5);
  assert.deepEqual([view.preset, view.range()], ["", [at("2026-11-20T08:00:00"), at("2026-11-20T12:00:00")]]);
});

test("yesterday is the day before at the site, and a link keeps its times", () => {
  const view = open("?s=line/1/actual&s=line/2/actual");
  view.showPreset("yesterday");
  assert.deepEqual(view.range(), [at("2026-11-19T00:00:00"), at("2026-11-20T00:00:00")]);
  const again = open(new URL(view.link(), "http://plant").search);
  assert.deepEqual([again.preset, again.range(), again.series], ["", view.range(), view.series]);
});

test("several values are removed at once", () => {
  const view = open("?s=line/1/actual&s=line/2/actual&s=line/3/actual");
  view.remove("line/1/actual", "line/3/actual");
  assert.deepEqual(view.series, ["line/2/actual"]);
});

test("what a view is compared with is part of its address", () => {
  const view = open("?compare=nonsense&preset=never");
  assert.deepEqual([view.compare, view.preset], ["", ""]);
  view.change({ compare: "day" });
  assert.equal(open(location.search).compare, "day");
});

test("each change reports what it changed", () => {
  const view = open();
  const changes = [];
  view.addEventListener("change", ({ detail }) => changes.push(detail));
  view.change({ a: NOW });
  view.show(NOW - 10, NOW);
  assert.deepEqual(changes, [["a"], ["from", "to", "preset"]]);
});

const UNITS = [
  { key: "line/1", name: "Unwind", labels: { "output.1": "heater" } },
  { key: "dry/end/2", name: "Dryer", labels: {} },
];
const named = new Catalogue(UNITS, { actual: "actual", "output.1": "output 1" });

test("a value is known if its unit and its name are", () => {
  assert.ok(named.has("line/1/actual"));
  assert.ok(!named.has("line/9/actual"));
  assert.ok(!named.has("line/1/speed"));
});

test("a value is called as it is wired, else by its name", () => {
  assert.equal(named.title("line/1/output.1"), "Unwind · heater");
  assert.equal(named.title("dry/end/2/output.1"), "Dryer · output 1");
});

test("the first values are the actual speeds of the first units", () => {
  assert.deepEqual(named.first(1), ["line/1/actual"]);
  assert.deepEqual(named.first(9), ["line/1/actual", "dry/end/2/actual"]);
});

test("a place is a unit by its name, or a bus", () => {
  assert.deepEqual([named.place("line", 1), named.place("line", 9), named.place("line", null)], [
    "Unwind",
    "line/9",
    "line",
  ]);
});

test("what happens at the units beside a unit on its line is requested too", () => {
  const line = new Catalogue(
    ["a/1", "a/2", "a/3", "b/1"].map((key) => ({ key, name: key, labels: {} })),
    { actual: "actual" },
  );
  assert.deepEqual(line.withNeighbors(["a/1/actual"]), ["a/1/actual", "a/2/actual"]);
  assert.deepEqual(line.withNeighbors(["a/3/actual"]), ["a/3/actual", "a/2/actual"], "not the next line");
});
