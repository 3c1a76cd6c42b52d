// What sounds on a panel.
import assert from "node:assert/strict";
import { test } from "node:test";
import { isDue, settingsOf, soundingNow, soundState, TONES } from "../../static/js/sound-rule.js";

const ON = { on: true, from: "high" };
const urgent = { priority: "urgent", at: 10 };

test("an alarm sounds where sound is on, and its priority has it", () => {
  assert.equal(soundingNow(ON, urgent, 0, true), "urgent");
  assert.equal(soundingNow(ON, { priority: "high", at: 10 }, 0, true), "high");
  assert.equal(soundingNow(ON, { priority: "medium", at: 10 }, 0, true), "");
  assert.equal(soundingNow({ ...ON, on: false }, urgent, 0, true), "");
  assert.equal(soundingNow(ON, { priority: "", at: 0 }, 0, true), "");
  assert.equal(soundingNow(ON, urgent, 0, false), "", "the server is lost");
});

test("silenced here, it is quiet until another one comes", () => {
  assert.equal(soundingNow(ON, urgent, 10, true), "");
  assert.equal(soundingNow(ON, { priority: "urgent", at: 10.5 }, 10, true), "urgent");
});

test("a page says whether its sound is off, waits for a press, sounds or is ready", () => {
  assert.equal(soundState(settingsOf(null), true, ""), "off");
  assert.equal(soundState(ON, false, "urgent"), "blocked");
  assert.equal(soundState(ON, true, "urgent"), "sounding");
  assert.equal(soundState(ON, true, ""), "ready");
});

test("tones are due at once for another priority, and again after a while", () => {
  assert.ok(isDue("urgent", { priority: "", at: 0 }, 1));
  assert.ok(isDue("urgent", { priority: "high", at: 1 }, 1));
  assert.ok(!isDue("urgent", { priority: "urgent", at: 1 }, 1 + TONES.urgent.everyS - 0.1));
  assert.ok(isDue("urgent", { priority: "urgent", at: 1 }, 1 + TONES.urgent.everyS));
  assert.ok(!isDue("", { priority: "urgent", at: 0 }, 99));
});

test("sound is off unless it was switched on, whatever is stored", () => {
  for (const text of [null, "", "{", "3", "{}", '{"on":"yes"}']) assert.deepEqual(settingsOf(text), { on: false, from: "low" });
  assert.deepEqual(settingsOf('{"on":true,"from":"high"}'), ON);
});
