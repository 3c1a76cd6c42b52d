// What sounds on a panel.
import assert from "node:assert/strict";
import { test } from "node:test";
import { isDue, settingsOf, soundingNow, soundState, TONES } from "../../static/js/sound-rule.js";

const ON = { on: true, from: "high", lost: false };
const WITH_LOST = { ...ON, lost: true };
const LOUD = { until: 0, lost: false };
const urgent = { priority: "urgent", at: 10 };

test("an alarm sounds where sound is on, and its priority has it", () => {
  assert.equal(soundingNow(ON, urgent, LOUD, "live"), "urgent");
  assert.equal(soundingNow(ON, { priority: "high", at: 10 }, LOUD, "live"), "high");
  assert.equal(soundingNow(ON, { priority: "medium", at: 10 }, LOUD, "live"), "");
  assert.equal(soundingNow({ ...ON, on: false }, urgent, LOUD, "live"), "");
  assert.equal(soundingNow(ON, { priority: "", at: 0 }, LOUD, "live"), "");
  assert.equal(soundingNow(ON, urgent, LOUD, "lost"), "", "the server is lost");
});

test("silenced here, it is quiet until another one comes", () => {
  const muted = { until: 10, lost: false };
  assert.equal(soundingNow(ON, urgent, muted, "live"), "");
  assert.equal(soundingNow(ON, { priority: "urgent", at: 10.5 }, muted, "live"), "urgent");
});

test("a lost server sounds where it was chosen, until it is silenced, and the alarms of before do not", () => {
  assert.equal(soundingNow(WITH_LOST, { priority: "", at: 0 }, LOUD, "lost"), "lost");
  assert.equal(soundingNow(WITH_LOST, urgent, LOUD, "lost"), "lost");
  assert.equal(soundingNow(WITH_LOST, urgent, { until: 0, lost: true }, "lost"), "");
  assert.equal(soundingNow(WITH_LOST, urgent, { until: 0, lost: true }, "live"), "urgent");
  assert.equal(soundingNow({ ...WITH_LOST, on: false }, urgent, LOUD, "lost"), "");
  assert.equal(soundingNow(WITH_LOST, urgent, LOUD, "connecting"), "", "a page that opens has lost nothing");
  assert.equal(soundingNow(ON, { priority: "lost", at: 10 }, LOUD, "live"), "", "no priority of an alarm");
});

test("a page shows whether its sound is off, waits for a press, sounds or is ready", () => {
  assert.equal(soundState(settingsOf(null), true, ""), "off");
  assert.equal(soundState(ON, false, "urgent"), "blocked");
  assert.equal(soundState(ON, true, "urgent"), "sounding");
  assert.equal(soundState(ON, true, ""), "ready");
  assert.equal(soundState(WITH_LOST, true, "lost", "lost"), "sounding");
  assert.equal(soundState(WITH_LOST, false, "lost", "lost"), "blocked");
  assert.equal(soundState(ON, false, "", "lost"), "ready");
});

test("tones are due at once for another priority, and again after a while", () => {
  assert.ok(isDue("urgent", { priority: "", at: 0 }, 1));
  assert.ok(isDue("urgent", { priority: "high", at: 1 }, 1));
  assert.ok(!isDue("urgent", { priority: "urgent", at: 1 }, 1 + TONES.urgent.everyS - 0.1));
  assert.ok(isDue("urgent", { priority: "urgent", at: 1 }, 1 + TONES.urgent.everyS));
  assert.ok(!isDue("", { priority: "urgent", at: 0 }, 99));
});

test("sound is off unless it was switched on, whatever is stored", () => {
  for (const text of [null, "", "{", "3", "{}", '{"on":"yes"}']) assert.deepEqual(settingsOf(text), { on: false, from: "low", lost: false });
  assert.deepEqual(settingsOf('{"on":true,"from":"high"}'), ON);
  assert.deepEqual(settingsOf('{"on":true,"from":"high","lost":true}'), WITH_LOST);
  assert.equal(settingsOf('{"on":true,"from":"lost","lost":"yes"}').from, "low");
  assert.equal(settingsOf('{"on":true,"from":"lost","lost":"yes"}').lost, false);
});
