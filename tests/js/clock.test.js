// The page counts time from the server's clock, never from the device's.
import assert from "node:assert/strict";
import { test } from "node:test";
import { openPage } from "./page.js";

const CLOCK = "../../static/js/clock.js";
let pages = 0;

async function open(page) {
  const clock = openPage(page);
  return { clock, ...(await import(`${CLOCK}?${pages++}`)) };
}

test("before the first message the time is that of the page's response", async () => {
  performance.getEntriesByType = () => [{ responseStart: 250 }];
  const { clock, now } = await open({ time: 1000 });
  clock.ms = 400;
  assert.ok(Math.abs(now() - 1000.15) < 1e-9);
  delete performance.getEntriesByType;
});

test("the message that was least delayed of the last twelve sets the clock", async () => {
  const { clock, received, now } = await open({ time: 0 });
  const receive = (delay) => {
    clock.ms += 1000;
    received(5000 + clock.ms / 1000 - delay);
  };
  receive(0.5);
  assert.equal(now(), 5000.5);
  receive(0.2);
  receive(0.9);
  assert.ok(Math.abs(now() - (5000 + 3 - 0.2)) < 1e-9);
  for (let i = 0; i < 11; i++) receive(0.7);
  assert.ok(Math.abs(now() - (5000 + 14 - 0.7)) < 1e-9, "the quick one is older than twelve messages");
});

test("after a sleep the next message alone sets the clock", async () => {
  const { received, forget, now } = await open({ time: 0 });
  received(9000);
  forget();
  received(5000);
  assert.equal(now(), 5000);
});

test("times are in the zone of the site", async () => {
  const { zone, zoneNote } = await open({ zone: "Europe/Berlin" });
  assert.deepEqual([zone, zoneNote], ["Europe/Berlin", ""]);
});

test("a zone that the browser does not know is UTC, and noted as such", async () => {
  const { zone, zoneNote } = await open({ zone: "Europe/Atlantis" });
  assert.deepEqual([zone, zoneNote], ["UTC", " UTC"]);
});
