// The one clock of the page: the server's time, as this page knows it, and the zone in which every time is shown.
// Every age is computed against it, never against this device's clock or zone.
// A message can only arrive late, so the least delay seen of the last few is the best estimate.
const UTC = "UTC";
const REMEMBERED = 12;
/** @type {number[]} */
const seen = [];
const { now: written, zone: named } = document.body.dataset;
let offset = Number(written) - (performance.getEntriesByType("navigation")[0]?.responseStart ?? 0) / 1000;

/** Take the time of a message from the server, Unix time in seconds.
 * @param {number} serverTime */
export function received(serverTime) {
  seen.push(serverTime - performance.now() / 1000);
  if (seen.length > REMEMBERED) seen.shift();
  offset = Math.max(...seen);
}

/** Forget what was measured: the device slept, or the page is connected again. */
export function forget() {
  seen.length = 0;
}

/** The server's time now, seconds since the epoch. */
export const now = () => performance.now() / 1000 + offset;

/** An old browser may not know the name of a zone that was renamed since: it takes UTC, never its own.
 * @param {string} [name] */
function resolved(name) {
  try {
    return new Intl.DateTimeFormat("en", { timeZone: name }).resolvedOptions().timeZone;
  } catch {
    return UTC;
  }
}

/** The site's time zone by its IANA name. */
export const zone = resolved(named);

/** What follows a time of day where no zone of a place is known: people take a bare time for their own. */
export const zoneNote = zone === UTC ? " UTC" : "";
