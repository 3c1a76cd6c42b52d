// The link to the server: a socket that only listens. First a complete snapshot, then numbered changes.
// A timeout counts as loss: within two seconds the page shows it, and removes its controls.

import { replace, show, value, verify } from "./bind.js";
import * as clock from "./clock.js";
import { giveBack } from "./focus.js";
import { language, put, span, word } from "./words.js";

const TIMEOUT_S = 1.9;
const CHECK_MS = 200;
/** Between two checks: after longer than this, the page itself stood still. */
const STILL_MS = 2 * CHECK_MS;
/** Time to handle the messages that arrived while the page stood still. */
const CATCH_UP_MS = 50;
const SPEAK_MS = 10_000;
const VERIFY_MS = 500;
/** Another program that changes the texts again so often within so long cannot be kept from it. */
const [ALTERED_TIMES, ALTERED_MS] = [4, 10_000];
const RELOADED = "reloaded-for";
const TOO_MANY = 429;
/** The close code of a right that was withdrawn; see app/people/auth/identify.py. */
const NO_LONGER_SIGNED_IN = 4401;
const RETRY_MS = [200, 500, 1000, 2000];

const body = document.body;
const url = body.dataset.liveUrl ?? "";
/** @type {WebSocket | null} */
let socket = null;
let number = -1;
let receivedAt = performance.now();
let checkedAt = receivedAt;
let lostSince = 0;
let cause = "closed";
let tries = 0;
let retry = 0;
/** Whether the server has responded by HTTP since a socket was last open. */
let respondsByHttp = false;
/** @type {{ units: string[], trace: string, lines?: true }} */
let interest = { units: [], trace: "" };
/** Whether the page shows all lines of all servers; see lines.js. */
const showsLines = document.querySelector("[data-lines]") !== null;
/** @type {(frames: Frame[]) => void} */
let frames = () => {};

export const link = () => body.dataset.link;
export const isLive = () => link() === "live";

/** Send to the server which units this page shows and whose frames it follows.
 * @param {string[]} units @param {string} [trace] @param {(frames: Frame[]) => void} [onFrames] */
export function follow(units, trace = "", onFrames = () => {}) {
  interest = showsLines ? { units, trace, lines: true } : { units, trace };
  frames = onFrames;
  if (socket?.readyState === WebSocket.OPEN) sendInterest();
}

const sendInterest = (want = "") => socket?.send(JSON.stringify({ want, ...interest }));

function open() {
  clearTimeout(retry);
  const mine = new WebSocket(new URL(url, location.href.replace(/^http/, "ws")));
  socket = mine;
  mine.onopen = () => {
    if (socket !== mine) return;
    respondsByHttp = false;
    sendInterest();
  };
  mine.onmessage = (event) => socket === mine && receive(JSON.parse(event.data));
  mine.onclose = ({ code }) => {
    if (socket !== mine) return;
    socket = null;
    // The page of the new role, or the one to log in; what is typed is kept as a draft. A pending command has its say first.
    if (code === NO_LONGER_SIGNED_IN && !document.querySelector("[data-pending]")) return location.reload();
    onLost("closed");
    if (respondsByHttp) cause = "sockets";
    again();
  };
}

function again() {
  clearTimeout(retry);
  retry = setTimeout(open, RETRY_MS[Math.min(tries, RETRY_MS.length - 1)]);
  tries += 1;
  if (tries % 5 === 3) findCause();
}

/** @param {LiveMessage} message */
function receive(message) {
  receivedAt = performance.now();
  if (message.is === "frames") return frames(message.frames);
  if (message.is === "lines") return onLines(message.f);
  clock.received(message.t);
  if (message.is === "snapshot") return onSnapshot(message);
  if (number < 0) return;
  if (message.p !== number) {
    number = -1;
    return sendInterest("snapshot");
  }
  number = message.n;
  show(message.f);
  beat(message.t);
}

/** @param {Groups} lines */
function onLines(lines) {
  show(lines);
  document.dispatchEvent(new CustomEvent("lineside:lines", { detail: Object.keys(lines) }));
}

/** Whether the page is of before the last start of its server. Once for each digest: copies of an overview may take turns.
 * @param {string} digest */
function isOutdated(digest) {
  if (digest === body.dataset.digest || sessionStorage.getItem(RELOADED) === digest) return false;
  sessionStorage.setItem(RELOADED, digest);
  return true;
}

/** @param {LiveMessage & { is: "snapshot" }} snapshot */
function onSnapshot(snapshot) {
  if (isOutdated(snapshot.digest)) return location.reload();
  for (const unit of document.querySelectorAll("[data-unit]")) {
    if (!(unit.dataset.unit in snapshot.f)) return location.reload();
  }
  number = snapshot.n;
  replace(snapshot.f);
  beat(snapshot.t);
  found();
}

// --- heartbeat: drawn from the server's words only, so a frozen page shows ------------------------

const clockFormat = new Intl.DateTimeFormat(language, {
  timeStyle: "medium",
  hourCycle: "h23",
  timeZone: clock.zone,
});
/** @param {number} seconds */
export const timeOfDay = (seconds) => clockFormat.format(seconds * 1000) + clock.zoneNote;
let beaten = 0;

/** @param {number} serverTime */
function beat(serverTime) {
  const second = Math.floor(serverTime);
  if (second === beaten) return;
  beaten = second;
  for (const hand of document.querySelectorAll("[data-pulse]"))
    hand.style.rotate = `${(second % 12) * 30}deg`;
  for (const text of document.querySelectorAll("[data-clock]"))
    put(text, timeOfDay(second));
}

// --- lost and found -----------------------------------------------------------------------------------

const covered = () => document.querySelectorAll(".main, .rail, .top");

/** @param {string} why */
function onLost(why) {
  if (body.dataset.link === "lost") return;
  lostSince = clock.now() - (performance.now() - receivedAt) / 1000;
  cause = navigator.onLine ? why : "offline";
  body.dataset.link = "lost";
  for (const part of covered()) part.inert = true;
  document.dispatchEvent(new CustomEvent("lineside:lost"));
  describe();
  document.querySelector(".gone")?.focus();
}

function found() {
  tries = 0;
  if (isAltered()) return;
  const was = body.dataset.link;
  body.dataset.link = "live";
  if (was !== "live") {
    for (const part of covered()) part.inert = false;
    document.dispatchEvent(new CustomEvent("lineside:found"));
    giveBack();
  }
}

function describe() {
  if (body.dataset.link !== "lost") return;
  /** @type {Record<string, string>} */
  const names = {
    closed: "causeClosed",
    timeout: "causeTimeout",
    offline: "causeOffline",
    sockets: "causeSockets",
    altered: "causeAltered",
  };
  document.querySelector("[data-gone-cause]").textContent = word(names[isAltered() ? "altered" : cause]);
  document.querySelector("[data-gone-since]").textContent = timeOfDay(lostSince);
  document.querySelector("[data-gone-for]").textContent = span(clock.now() - lostSince);
}

/** @type {number[]} */
let alterations = [];
const isAltered = () => "altered" in body.dataset;

/** A page whose texts another program changes again and again would show an old state between two of them: it is covered
 * until a person has loaded it again. */
function verifyTexts() {
  if (!isLive() || !verify()) return;
  const now = performance.now();
  alterations = [...alterations.filter((at) => now - at < ALTERED_MS), now];
  if (alterations.length < ALTERED_TIMES) return;
  body.dataset.altered = "";
  onLost("altered");
}

/** A page that a browser has kept and shows again is of the time when it was left.
 * @param {PageTransitionEvent} event */
function shownAgain({ persisted }) {
  if (persisted) {
    onLost("closed");
    if (socket) drop(socket);
  }
  awake();
}

/** Where the server responds and the next socket does not open either, a proxy between does not pass WebSockets. */
async function findCause() {
  try {
    const response = await fetch(cause === "sockets" ? "/live?failed=true" : "/live", {
      redirect: "manual",
      cache: "no-store",
      signal: AbortSignal.timeout(2000),
    });
    if (response.type === "opaqueredirect" || response.status === 401) location.reload();
    respondsByHttp = response.status < 500 && response.status !== TOO_MANY;
  } catch {
    // No response: the overlay shows it already.
  }
}

/** A clock that stands still while the device sleeps would show old values as fresh: compare with the other clock. */
const ahead = () => Date.now() - performance.now();
let wasAhead = ahead();

function noticeSleep() {
  const slept = ahead() - wasAhead;
  wasAhead += slept;
  if (slept > TIMEOUT_S * 1000) {
    receivedAt -= slept;
    clock.forget();
  }
}

/** A late check proves nothing about the server: messages may be queued behind it, so handle them first. */
function check() {
  noticeSleep();
  const since = performance.now() - checkedAt;
  checkedAt += since;
  if (since > STILL_MS) setTimeout(judge, CATCH_UP_MS);
  else judge();
}

function judge() {
  const age = (performance.now() - receivedAt) / 1000;
  if (age > TIMEOUT_S && body.dataset.link !== "lost") onLost("timeout");
  if (age > TIMEOUT_S && socket?.readyState === WebSocket.OPEN) drop(socket);
  describe();
}

/** Do not wait for a socket without messages: a cable was pulled, or the device slept.
 * @param {WebSocket} old */
function drop(old) {
  socket = null;
  number = -1;
  old.onclose = null;
  old.close();
  again();
}

function awake() {
  if (document.visibilityState !== "visible") return;
  check();
  if (!socket) {
    tries = 0;
    open();
  }
}

export function start() {
  if (!url) return;
  open();
  setInterval(check, CHECK_MS);
  setInterval(() => socket?.readyState === WebSocket.OPEN && sendInterest(), SPEAK_MS);
  document.addEventListener("visibilitychange", awake);
  document.addEventListener("resume", awake);
  addEventListener("pageshow", shownAgain);
  addEventListener("beforeprint", verifyTexts);
  setInterval(verifyTexts, VERIFY_MS);
  addEventListener("online", awake);
}

export { value };
