// What sounds now: a rule without a clock, a browser or a page.

/** By priority, the most important first: how many tones of how many hertz, every so many seconds. */
export const TONES = {
  urgent: { tones: 3, hertz: 880, everyS: 2 },
  high: { tones: 2, hertz: 660, everyS: 4 },
  medium: { tones: 1, hertz: 520, everyS: 8 },
  low: { tones: 1, hertz: 390, everyS: 20 },
};
const PRIORITIES = Object.keys(TONES);

/** The priority whose tones are due on this panel, or "". `settings`: whether sound is on, and the least important
 * priority that has it. `alarms`: the priority that sounds, and when the newest of those that do began. `mutedUntil`:
 * those up to this time were silenced here. */
export function soundingNow(settings, alarms, mutedUntil, isLive) {
  if (!settings.on || !isLive || !(alarms.priority in TONES) || alarms.at <= mutedUntil) return "";
  return PRIORITIES.indexOf(alarms.priority) <= PRIORITIES.indexOf(settings.from) ? alarms.priority : "";
}

/** What this panel tells of its sound: off, blocked (the browser waits for a press), sounding or ready. */
export function soundState(settings, hasLeave, priority) {
  if (!settings.on) return "off";
  if (!hasLeave) return "blocked";
  return priority ? "sounding" : "ready";
}

/** Whether the tones are due: at once when another priority or alarm sounds, then again and again. */
export const isDue = (priority, sounded, now) =>
  priority !== "" && (priority !== sounded.priority || now - sounded.at >= TONES[priority].everyS);

/** What was stored, or sound off. */
export function settingsOf(text) {
  try {
    const { on, from } = JSON.parse(text) ?? {};
    return { on: on === true, from: PRIORITIES.includes(from) ? from : "low" };
  } catch {
    return { on: false, from: "low" };
  }
}
