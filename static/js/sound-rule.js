// What sounds now: a rule without a clock, a browser or a page.

/** By priority, the most important first: how many tones of how many hertz, every so many seconds.
 * @type {Record<string, { tones: number, hertz: number, everyS: number }>} */
export const TONES = {
  urgent: { tones: 3, hertz: 880, everyS: 2 },
  high: { tones: 2, hertz: 660, everyS: 4 },
  medium: { tones: 1, hertz: 520, everyS: 8 },
  low: { tones: 1, hertz: 390, everyS: 20 },
  lost: { tones: 4, hertz: 290, everyS: 5 },
};
const PRIORITIES = ["urgent", "high", "medium", "low"];

/** The priority whose tones are due on this panel, "lost" for those of a lost server, or "". `settings`: whether sound
 * is on, the least important priority that has it, and whether a lost server has. `alarms`: the priority that sounds,
 * and when the newest of those that do began. `muted`: `until`, those up to this time were silenced here; `lost`, this
 * loss was. `link`: "live", "lost" or on the way to it.
 * @param {SoundSettings} settings @param {Sounding} alarms @param {Muted} muted @param {string} [link] */
export function soundingNow(settings, alarms, muted, link) {
  if (!settings.on) return "";
  if (link === "lost") return settings.lost && !muted.lost ? "lost" : "";
  if (link !== "live" || !PRIORITIES.includes(alarms.priority) || alarms.at <= muted.until) return "";
  return PRIORITIES.indexOf(alarms.priority) <= PRIORITIES.indexOf(settings.from) ? alarms.priority : "";
}

/** What this panel shows of its sound: off, blocked (the browser waits for a press), sounding or ready. Of a lost server
 * that has no sound it shows nothing.
 * @param {SoundSettings} settings @param {boolean} hasLeave @param {string} priority @param {string} [link] */
export function soundState(settings, hasLeave, priority, link) {
  if (!settings.on) return "off";
  if (link === "lost" && !settings.lost) return "ready";
  if (!hasLeave) return "blocked";
  return priority ? "sounding" : "ready";
}

/** Whether the tones are due: at once when another priority or alarm sounds, then again and again.
 * @param {string} priority @param {Sounding} sounded @param {number} now */
export const isDue = (priority, sounded, now) =>
  priority !== "" && (priority !== sounded.priority || now - sounded.at >= TONES[priority].everyS);

/** What was stored, or sound off.
 * @param {string | null} text @returns {SoundSettings} */
export function settingsOf(text) {
  try {
    const { on, from, lost } = JSON.parse(text ?? "null") ?? {};
    return { on: on === true, from: PRIORITIES.includes(from) ? from : "low", lost: lost === true };
  } catch {
    return { on: false, from: "low", lost: false };
  }
}
