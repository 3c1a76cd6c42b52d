// The trends page: nothing happens before it is started, and what each of its values is called.
import assert from "node:assert/strict";
import { test } from "node:test";
import { openPage } from "./page.js";

openPage();
const begun = [];
for (const name of ["fetch", "setInterval", "setTimeout", "matchMedia", "requestAnimationFrame"])
  globalThis[name] = () => begun.push(name);
const { Catalogue } = await import("../../static/js/trends-catalogue.js");
await import("../../static/js/trends-page.js");

const UNITS = [
  { key: "line/1", name: "Unwind", labels: { "output.1": "heater" } },
  { key: "dry/end/2", name: "Dryer", labels: {} },
];
const catalogue = new Catalogue(UNITS, { actual: "actual", "output.1": "output 1" });

test("a module that imports the page starts nothing", () => {
  assert.deepEqual(begun, []);
});

test("a value is known if its unit and its name are", () => {
  assert.ok(catalogue.has("line/1/actual"));
  assert.ok(!catalogue.has("line/9/actual"));
  assert.ok(!catalogue.has("line/1/speed"));
});

test("a value is called as it is wired, else by its name", () => {
  assert.equal(catalogue.title("line/1/output.1"), "Unwind · heater");
  assert.equal(catalogue.title("dry/end/2/output.1"), "Dryer · output 1");
});

test("the first values are the actual speeds of the first units", () => {
  assert.deepEqual(catalogue.first(1), ["line/1/actual"]);
  assert.deepEqual(catalogue.first(9), ["line/1/actual", "dry/end/2/actual"]);
});

test("a place is a unit by its name, or a bus", () => {
  assert.deepEqual([catalogue.place("line", 1), catalogue.place("line", 9), catalogue.place("line", null)], [
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
