// Drawing keeps to its share of the main thread, and a quick device waits for nothing.
import assert from "node:assert/strict";
import { test } from "node:test";
import { openPage } from "./page.js";

const RUN_MS = 20_000;
/** Of the main thread. */
const MOST = 0.25;
const LONGEST_MS = 600;
const PACE = "../../static/js/pace.js";
let devices = 0;

/** A device on which time passes by what is done: `write` ms to write, `frame` ms to lay out and paint, `early` of it
 * before the callbacks of the frame, where a pointer is over the page. Something new to draw comes every `every` ms.
 * Of each drawing: when it began, and how long what it drew had waited. */
async function drawings(write, frame, every, early = 0) {
  const clock = openPage();
  let timers = [];
  let frames = [];
  const messages = [];
  globalThis.setTimeout = (act, wait, ...rest) => timers.push({ at: clock.ms + wait, act: () => act(...rest) });
  globalThis.requestAnimationFrame = (act) => frames.push(act);
  globalThis.MessageChannel = class {
    port1 = {};
    port2 = { postMessage: () => messages.push(() => this.port1.onmessage()) };
  };
  const { soon } = await import(`${PACE}?${devices++}`);
  const drawn = [];
  let waits = null;
  const draw = () => {
    drawn.push({ began: clock.ms, waited: waits === null ? 0 : clock.ms - waits });
    waits = null;
    clock.ms += write;
    return write > 0;
  };
  for (let next = 0; clock.ms < RUN_MS; clock.ms += 1) {
    if (clock.ms >= next) {
      next = Math.max(next + every, clock.ms);
      waits ??= clock.ms;
      soon(draw);
    }
    const due = timers.filter(({ at }) => at <= clock.ms);
    timers = timers.filter(({ at }) => at > clock.ms);
    for (const { act } of due) act();
    const requested = frames;
    frames = [];
    const begun = clock.ms;
    if (requested.length) clock.ms += early;
    for (const act of requested) act(begun);
    if (requested.length) clock.ms += frame - early;
    for (const message of messages.splice(0)) message();
  }
  return drawn;
}

const longestWait = (drawn) => Math.max(...drawn.map(({ waited }) => waited));

for (const [write, frame, early] of [
  [3, 7, 0],
  [10, 30, 0],
  [20, 80, 0],
  [10, 30, 25],
])
  test(`a device that takes ${write + frame} ms, ${early} early, draws within the share, and uses it`, async () => {
    const spent = (await drawings(write, frame, 10, early)).length * (write + frame);
    assert.ok(spent <= MOST * RUN_MS, `${spent} ms`);
    assert.ok(spent >= 0.5 * MOST * RUN_MS, `${spent} ms`);
  });

test("a quick device draws at once", async () => {
  const drawn = await drawings(1, 2, 26);
  assert.ok(drawn.length >= RUN_MS / 26 - 1);
  assert.equal(longestWait(drawn), 0);
});

test("a device that draws within 5 ms draws at once, with as many changes as a bus has", async () => {
  const drawn = await drawings(1, 4, 26, 3);
  assert.ok(drawn.length >= RUN_MS / 26 - 1);
  assert.equal(longestWait(drawn), 0);
});

test("a drawing of nothing visible costs no share", async () => {
  assert.equal(longestWait(await drawings(0, 80, 10)), 0);
});

test("nothing waits longer than the limit on the slowest device", async () => {
  const drawn = await drawings(100, 300, 10);
  const apart = drawn.slice(1).map(({ began }, i) => began - drawn[i].began);
  assert.ok(drawn.length > 10);
  assert.ok(Math.max(...apart) <= LONGEST_MS + 10);
});

test("a hidden page measures no frame", async () => {
  openPage();
  const { soon } = await import(`${PACE}?hidden`);
  globalThis.requestAnimationFrame = () => assert.fail("no frame comes while the page is hidden");
  document.hidden = true;
  soon(() => true);
});

const { credible, readyAt, usedUp } = await import(PACE);

test("a cost that is more than twice the least of the last four was not drawing", () => {
  assert.equal(credible([4, 6, 5, 7]), 7);
  assert.equal(credible([4, 6, 5, 900]), 8);
  assert.equal(credible([900, 900, 900, 4]), 4);
  assert.equal(credible([900]), 0);
});

test("a few cheap drawings in a row wait for nothing, many do, also after a long rest", () => {
  const began = 1_000_000;
  let until = 0;
  const ready = Array.from({ length: 30 }, () => {
    until = usedUp(until, began, 3);
    return readyAt(until) <= began;
  });
  assert.deepEqual(ready.slice(0, 3), [true, true, true]);
  assert.equal(ready.at(-1), false);
});
