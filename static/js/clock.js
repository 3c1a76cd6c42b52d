// The server's clock, as this page knows it. Every age is computed against it, never against this device's.
// A message can only arrive late, so the least delay seen of the last few is the best estimate.
const REMEMBERED = 12;
const seen = [];
let offset = 0;

/** A message from the server said that its time is `serverTime` (seconds since the epoch). */
export function heard(serverTime) {
  seen.push(serverTime - performance.now() / 1000);
  if (seen.length > REMEMBERED) seen.shift();
  offset = Math.max(...seen);
}

/** Forget what was measured: the device slept, or another server answers. */
export function forget() {
  seen.length = 0;
}

/** The server's time now, seconds since the epoch. */
export const now = () => performance.now() / 1000 + offset;
