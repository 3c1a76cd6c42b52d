// The link is lost when the server sends nothing for two seconds, and not because the page itself was suspended.
import assert from "node:assert/strict";
import { test } from "node:test";
import { openPage } from "./page.js";

const CHECK_MS = 200;
const PROMISED_MS = 2000 + CHECK_MS;
let pages = 0;

/** A page whose link is up. `run` lets time pass, with a message of the server every `every` ms; in `stand` time
 * passes without a timer, and then those that are due come before what was received. */
async function openLive() {
  const clock = openPage();
  const timers = [];
  const lost = [];
  const wait = (act, ms, every) => timers.push({ at: clock.ms + ms, act, every });
  globalThis.setTimeout = (act, ms) => wait(act, ms);
  globalThis.setInterval = (act, ms) => wait(act, ms, ms);
  globalThis.clearTimeout = (timer) => timers.splice(timer - 1, 1, { at: Number.POSITIVE_INFINITY });
  globalThis.addEventListener = () => {};
  globalThis.navigator = { onLine: true };
  const shown = {};
  let refuses = false;
  let socket;
  globalThis.WebSocket = class {
    static OPEN = 1;
    readyState = refuses ? 0 : 1;
    constructor() {
      socket = this;
    }
    send() {}
    close() {}
  };
  Object.assign(document, {
    addEventListener: () => {},
    dispatchEvent: ({ type }) => type === "lineside:lost" && lost.push(clock.ms),
    querySelector: (selector) => (selector === "[data-gone-cause]" ? shown : { focus() {} }),
  });
  document.body.dataset.liveUrl = "/live";
  location.href = "http://plant.example/";
  const { isLive, start } = await import(`../../static/js/live.js?${pages++}`);
  start();
  const receive = (message) => socket.onmessage({ data: JSON.stringify(message) });
  const due = () => {
    for (const timer of timers.filter(({ at }) => at <= clock.ms)) {
      timer.at = timer.every ? clock.ms + timer.every : Number.POSITIVE_INFINITY;
      timer.act();
    }
  };
  let number = 0;
  document.body.dataset.digest = "a";
  receive({ is: "snapshot", digest: "a", n: 0, t: 0, f: {} });
  const page = {
    lost,
    receive,
    isLive,
    refuse() {
      refuses = true;
      socket.onclose({ code: 1006 });
    },
    open: () => socket.onopen(),
    cause: () => shown.textContent,
    speak: () => receive({ is: "changes", p: number, n: ++number, t: clock.ms / 1000, f: {} }),
    run(ms, every = Number.POSITIVE_INFINITY) {
      for (const end = clock.ms + ms; clock.ms < end; ) {
        clock.ms += 1;
        if (clock.ms % every === 0) page.speak();
        due();
      }
    },
    stand(ms) {
      clock.ms += ms;
      due();
    },
    now: () => clock.ms,
  };
  assert.ok(isLive());
  return page;
}

test("a page whose server speaks is live", async () => {
  const page = await openLive();
  page.run(20_000, 1000);
  assert.deepEqual(page.lost, []);
});

test("a server that sends nothing is lost within the time promised", async () => {
  const page = await openLive();
  page.run(3000, 1000);
  page.run(PROMISED_MS);
  assert.equal(page.lost.length, 1);
  assert.ok(page.lost[0] - 3000 <= PROMISED_MS, `${page.lost[0]}`);
});

test("a page that stood still first receives what was sent meanwhile", async () => {
  const page = await openLive();
  page.run(3000, 1000);
  page.stand(2500);
  page.speak();
  page.run(3000, 1000);
  assert.deepEqual(page.lost, []);
  assert.ok(page.isLive());
});

test("a page that stood still and has received nothing is lost before the next check", async () => {
  const page = await openLive();
  page.run(3000, 1000);
  page.stand(2500);
  const still = page.now();
  page.run(CHECK_MS);
  assert.equal(page.lost.length, 1);
  assert.ok(page.lost[0] - still < CHECK_MS, `${page.lost[0]}`);
});

test("a page that is kept from its turns again and again still finds its server lost", async () => {
  const page = await openLive();
  page.run(3000, 1000);
  for (let turn = 0; turn < 5; turn++) page.stand(1000);
  assert.ok(page.lost.length > 0);
});

test("a server that responds while no socket opens is behind a proxy that does not pass WebSockets", async () => {
  const page = await openLive();
  const fetched = [];
  globalThis.fetch = async (address) => {
    fetched.push(address);
    return { type: "basic", status: 426 };
  };
  globalThis.AbortSignal.timeout = () => undefined;
  for (let tries = 0; tries < 10; tries++) {
    page.refuse();
    page.run(2000);
    await new Promise(setImmediate);
    if (fetched.length === 0) assert.equal(page.cause(), "causeClosed");
  }
  assert.equal(page.cause(), "causeSockets");
  assert.deepEqual(fetched, ["/live", "/live?failed=true"]);
  page.open();
  page.receive({ is: "snapshot", digest: "a", n: 0, t: 0, f: {} });
  page.refuse();
  page.run(CHECK_MS);
  assert.equal(page.cause(), "causeClosed");
});

test("a server that starts again with other names has the page load them once, also beside one with the former", async () => {
  const page = await openLive();
  const stored = {};
  globalThis.sessionStorage = { getItem: (key) => stored[key], setItem: (key, text) => (stored[key] = text) };
  let loaded = 0;
  location.reload = () => loaded++;
  page.receive({ is: "snapshot", digest: "a", n: 7, t: 0, f: {} });
  assert.equal(loaded, 0);
  page.receive({ is: "snapshot", digest: "b", n: 0, t: 0, f: {} });
  assert.equal(loaded, 1);
  page.receive({ is: "snapshot", digest: "b", n: 0, t: 0, f: {} });
  assert.equal(loaded, 1);
});
