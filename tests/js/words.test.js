// Texts and spans of time in the language of the page.
import assert from "node:assert/strict";
import { test } from "node:test";
import { openPage } from "./page.js";

const words = { seconds: "{n} s", minutes: "{n} min", hours: "{n} h", never: "nie" };
openPage({ language: "de", words });
const { span, word } = await import("../../static/js/words.js");

test("a span of time is in the largest unit that is exact enough, rounded down", () => {
  const spans = [-1, 0.34, 9.94, 9.95, 119.9, 120, 7199, 7200, 90_000].map(span);
  assert.deepEqual(spans, ["0,0 s", "0,3 s", "9,9 s", "9 s", "119 s", "2 min", "119 min", "2 h", "25 h"]);
});

test("a text has its value in it, and one that is missing is its name", () => {
  assert.equal(word("minutes", 10), "10 min");
  assert.equal(word("never"), "nie");
  assert.equal(word("unheardOf"), "unheardOf");
});
