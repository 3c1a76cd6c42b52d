// Values age on the page: the quality that the server reports can become worse here, never better.
import assert from "node:assert/strict";
import { test } from "node:test";
import { openPage } from "./page.js";

const clock = openPage();
const { replace, show } = await import("../../static/js/bind.js");
const { received } = await import("../../static/js/clock.js");
const { qualityOf, silenceOf } = await import("../../static/js/quality.js");

const BUS = { stale_after: 2, offline_after: 5 };
const unit = (more) => ({ line: BUS, "line/1": { at: 1000, link: "online", ...more } });

function qualityAfter(seconds) {
  clock.ms = 1000 * seconds;
  return qualityOf("line/1");
}

test("a value that is not renewed is stale, then offline", () => {
  received(1000);
  replace(unit());
  assert.deepEqual([2, 2.1, 5, 5.1].map(qualityAfter), ["online", "stale", "stale", "offline"]);
});

test("a new value is online again", () => {
  show({ "line/1": { at: 1009 } });
  assert.equal(qualityAfter(10), "online");
});

test("what the server calls offline is offline however young its value", () => {
  replace(unit({ at: 1010, link: "offline" }));
  assert.equal(qualityAfter(10), "offline");
});

test("what was never read is unknown, also after a snapshot without it", () => {
  replace(unit({ at: undefined }));
  assert.equal(qualityAfter(10), "unknown");
  replace({});
  assert.equal(qualityAfter(10), "unknown");
});

test("a unit that is not live has been silent since its last reading, one that was never read has no age", () => {
  replace(unit({ at: 1010 }));
  clock.ms = 11_000;
  assert.equal(silenceOf("line/1"), "");
  clock.ms = 13_000;
  assert.equal(silenceOf("line/1"), "lastResponse");
  replace(unit({ at: undefined }));
  assert.equal(silenceOf("line/1"), "");
});
