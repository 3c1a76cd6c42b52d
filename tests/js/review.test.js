// A review ends once its unit takes nothing from here any more, and states why.
import assert from "node:assert/strict";
import { test } from "node:test";
import { openPage } from "./page.js";

openPage({ words: { stoppedResponding: "no response", leftRemote: "local", wasBlocked: "blocked: {n}" } });
document.querySelector = () => null;
const { whyNot } = await import("../../static/js/review.js");
const UNIT = { link: "online", mode: "remote", blocked: "" };

test("a unit whose response is late has not stopped responding", () => {
  assert.equal(whyNot(UNIT), "");
  assert.equal(whyNot({ ...UNIT, link: "stale" }), "");
  assert.equal(whyNot({ ...UNIT, link: "offline" }), "no response");
});

test("a unit in LOCAL or blocked takes nothing", () => {
  assert.equal(whyNot({ ...UNIT, mode: "local" }), "local");
  assert.equal(whyNot({ ...UNIT, blocked: "belt off" }), "blocked: belt off");
});
