// Sound for alarms to acknowledge, and for a lost server, on a device whose user has switched it on. Browsers allow it
// only after a press.
import { listen } from "./bind.js";
import { link } from "./live.js";
import { isDue, settingsOf, soundingNow, soundState, TONES } from "./sound-rule.js";
import { word } from "./words.js";

const STORED = "lineside-sound";
const CHECK_MS = 500;
const TONE_S = 0.18;
const PAUSE_S = 0.28;
const LOUDNESS = 0.4;
/** @param {string} name */
/** @template {keyof SoundParts} K @param {K} name */
const find = (name) => /** @type {SoundParts[K]} */ (document.querySelector(`[data-sound-${name}]`));

let settings = settingsOf(null);
/** @type {AudioContext | null} */
let audio = null;
let alarms = { priority: "", at: 0 };
const muted = { until: 0, lost: false };
let sounded = { priority: "", at: 0 };
/** Of several pages of one browser the first that may sound does. */
let isFirst = !navigator.locks;
let isQueued = false;

const hasLeave = () => audio?.state === "running";
const sounding = () => soundingNow(settings, alarms, muted, link());

function read() {
  try {
    return localStorage.getItem(STORED);
  } catch {
    return null;
  }
}

/** @param {Partial<SoundSettings>} changed */
function store(changed) {
  settings = { ...settings, ...changed };
  try {
    localStorage.setItem(STORED, JSON.stringify(settings));
  } catch {
    // A browser that keeps nothing still sounds on this page.
  }
}

/** In a press this gives the leave to sound; without one the browser waits for it. */
async function open() {
  audio ??= new AudioContext();
  audio.onstatechange = draw;
  if (!hasLeave()) await audio.resume().catch(() => {});
  draw();
}

function queue() {
  if (isQueued || isFirst) return;
  isQueued = true;
  navigator.locks.request(STORED, () => {
    isFirst = true;
    return new Promise(() => {});
  });
}

/** @param {string} priority */
function play(priority) {
  if (!audio) return;
  const { tones, hertz } = TONES[priority];
  for (let i = 0; i < tones; i++) {
    const begins = audio.currentTime + i * PAUSE_S;
    const tone = new OscillatorNode(audio, { frequency: hertz, type: "square" });
    const gain = new GainNode(audio, { gain: 0 });
    gain.gain.setTargetAtTime(LOUDNESS, begins, 0.01);
    gain.gain.setTargetAtTime(0, begins + TONE_S - 0.05, 0.01);
    tone.connect(gain).connect(audio.destination);
    tone.start(begins);
    tone.stop(begins + TONE_S);
  }
}

function sound() {
  draw();
  const priority = sounding();
  const now = performance.now() / 1000;
  if (hasLeave() && settings.on) queue();
  if (hasLeave() && isFirst && isDue(priority, sounded, now)) {
    play(priority);
    sounded = { priority, at: now };
  }
  if (!priority) sounded = { priority: "", at: 0 };
}

let drawn = "";

function draw() {
  const state = soundState(settings, hasLeave(), sounding(), link());
  const shownNow = `${state} ${link()}`;
  if (shownNow === drawn) return;
  drawn = shownNow;
  const [strip, shown] = [find("strip"), find("state")];
  strip.hidden = state !== "blocked" && state !== "sounding";
  find("text").textContent = state === "blocked" ? word("alarmSoundBlocked") : "";
  find("word").textContent = word(
    state === "blocked" ? "alarmSoundAllow" : link() === "lost" ? "lostSoundSilence" : "alarmSoundSilence",
  );
  /** @type {Record<string, string>} */
  const names = { off: "alarmSoundOff", blocked: "alarmSoundBlocked" };
  if (shown) shown.textContent = word(names[state] ?? "alarmSoundOn");
}

/** On this panel at once, and on every panel where the user may. */
function silence() {
  if (link() === "lost") {
    muted.lost = true;
    return draw();
  }
  muted.until = alarms.at;
  draw();
  const body = new URLSearchParams({ until: String(alarms.at) });
  if ("soundActs" in find("strip").dataset) fetch("/alarms/silence", { method: "POST", body }).catch(() => {});
}

async function press() {
  if (drawn.startsWith("sounding")) silence();
  else await open();
}

function bindSettings() {
  const [on, from, lost, test] = [find("on"), find("from"), find("lost"), find("test")];
  if (!on) return;
  on.checked = settings.on;
  from.value = settings.from;
  lost.checked = settings.lost;
  on.addEventListener("change", () => {
    store({ on: on.checked });
    open();
  });
  from.addEventListener("change", () => store({ from: from.value }));
  lost.addEventListener("change", () => store({ lost: lost.checked }));
  test.addEventListener("click", async () => {
    await open();
    if (hasLeave()) play(from.value);
  });
}

/** The overlay for a lost server covers the page: the strip is in it as long as it is there. */
function followLink() {
  const [strip, gone] = [find("strip"), document.querySelector(".gone")];
  const place = document.createComment("sound");
  strip.before(place);
  document.addEventListener("lineside:lost", () => {
    gone.querySelector(".gone__box").append(strip);
    sound();
  });
  document.addEventListener("lineside:found", () => {
    place.before(strip);
    muted.lost = false;
    sound();
  });
}

export function start() {
  if (!find("strip")) return;
  settings = settingsOf(read());
  bindSettings();
  followLink();
  find("press").addEventListener("click", press);
  // Another page of this browser has changed them.
  addEventListener("storage", ({ key, newValue }) => {
    if (key === STORED) settings = settingsOf(newValue);
  });
  // Any press gives leave, as long as sound is on. That of the button does so in its own handler: it would silence.
  /** @param {Event} event */
  const openElsewhere = ({ target }) =>
    settings.on && !hasLeave() && !find("strip").contains(/** @type {Node | null} */ (target)) && open();
  for (const kind of ["pointerup", "keyup"]) addEventListener(kind, openElsewhere);
  listen("alarms_present", (fields) => {
    alarms = { priority: fields.sound ?? "", at: Number(fields.sound_at) || 0 };
    sound();
  });
  if (settings.on) open();
  setInterval(sound, CHECK_MS);
}
