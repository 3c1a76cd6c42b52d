// The trends page: the view selects, the history responds, the chart, the legend and the table show the result. What every page
// has comes after the picture.
import { now } from "./clock.js";
import { fetchAlarms, fetchMarks } from "./history-requests.js";
import { formatTime } from "./site-time.js";
import { bindControls, bindGestures, bindNotes, showControls } from "./trends-controls.js";
import { comparison, fetchNotes, fetchSeries, fetchWindows, unread } from "./trends-data.js";
import { Picture } from "./trends-plot.js";
import { length, shortTime } from "./trends-time.js";
import { clearLists, drawLists, fineness, isBit, summaryText, Values, valuesText } from "./trends-values.js";
import { Catalogue, unitOf, View } from "./trends-view.js";

const SETTLE_MS = 60;
const BEAT_MS = 1000;
const MARKS_EVERY_S = 15;
const REFRESHES_PER_SPAN = 300;
const REST_WAITS_MS = 1000;
/** What changes the colors. */
const MEDIA = ["(prefers-color-scheme: dark)", "(forced-colors: active)", "print"];

const root = document.getElementById("trends");
const plot = document.getElementById("trend-plot");
const words = document.getElementById("trend-words").dataset;
const catalogue = new Catalogue(JSON.parse(root.dataset.catalogue), JSON.parse(root.dataset.valueWords));
const view = new View(catalogue, JSON.parse(root.dataset.shiftStarts));
/** @type {Trends} */
const trends = {
  ...{ words, catalogue, view, range: view.range(), at: null, chosen: "", dimmed: new Set(), unknown: [], silent: new Map() },
  ...{ curves: [], past: [], compared: null, marks: [], alarms: [], notes: [], more: new Set(), room: { chart: 600, beside: 0 } },
};
const picture = new Picture(plot, trends, { cursor: moved, selected: (from, to) => view.show(from, to) });
const values = new Values(trends);
const requestedAt = { data: 0, marks: 0 };
/** How long a unit has been silent; none is until what every page has is loaded. @param {string} _unit */
let silenceOf = (_unit) => "";
/** @type {AbortController | null} */
let pending = null;
let settling = 0;

// --- requests -----------------------------------------------------------------------------------------------

/** Request the curves and draw them; settled once they are drawn or their request has failed. */
async function fetchCurves() {
  pending?.abort();
  pending = new AbortController();
  const wanted = [...view.series];
  requestedAt.data = Date.now();
  try {
    const found = await fetchSeries(wanted, trends.range, points(), pending.signal);
    trends.curves = curves(found, wanted);
    explain("");
    drawAll();
  } catch (error) {
    if (!(error instanceof DOMException && error.name === "AbortError")) explain(why(error));
  }
}

/** @param {Result[]} results @param {string[]} keys @returns {Curve[]} */
function curves(results, keys) {
  const labels = catalogue.labels(keys);
  return results.map((result, i) => {
    const [key, label] = [keys[i], labels[i]];
    return { ...result, key, label, place: view.series.indexOf(key), name: catalogue.title(key), past: false };
  });
}

const points = () => Math.max(200, Math.min(2000, Math.round(plot.clientWidth)));

/** Request what happened in the span, and what it is compared with. */
async function fetchEvents() {
  requestedAt.marks = Date.now();
  try {
    const { range } = trends;
    const [{ marks, more }, active, notes, past] = await Promise.all([
      fetchMarks(view.series, range),
      fetchAlarms(catalogue.withNeighbors(view.series), range),
      fetchNotes(view.series, range),
      fetchPast(range),
    ]);
    const cut = new Set([more ? "events" : "", active.more ? "alarms" : ""]);
    Object.assign(trends, { marks, notes, past, alarms: active.alarms, more: cut });
    drawLists(trends, put);
    drawAll();
  } catch (error) {
    // None are known, though there may be some.
    Object.assign(trends, { marks: [], alarms: [], notes: [], past: [] });
    clearLists();
    explain(why(error));
  }
}

/** Request the span compared, with as much more as passes until it is requested again, and move it to this one.
 * @param {Span} range @returns {Promise<Curve[]>} */
async function fetchPast(range) {
  trends.compared = await comparison(view, range, words);
  const offset = trends.compared?.offset ?? null;
  if (offset === null) return [];
  const wanted = view.series.filter((key) => !isBit({ value: catalogue.split(key)[1] }));
  const found = await fetchSeries(wanted, [range[0] - offset, range[1] - offset + MARKS_EVERY_S], points());
  return curves(found, wanted).map((curve) => ({ ...curve, past: true, t: curve.t.map((at) => at + offset) }));
}

/** Once a second: what follows now moves on, and requests as often as a pixel's worth has passed. */
function beat() {
  if (document.hidden || !view.live) return;
  const wasSilent = trends.silent.size > 0;
  spanChanged();
  if (wasSilent || trends.silent.size) values.read();
  const [from, to] = trends.range;
  const due = Math.max(2000, ((to - from) * 1000) / REFRESHES_PER_SPAN);
  if (Date.now() - requestedAt.data >= due) fetchCurves();
  if (Date.now() - requestedAt.marks >= MARKS_EVERY_S * 1000) fetchEvents();
}

// --- changes ------------------------------------------------------------------------------------------------

/** @param {string[]} names of what the view has changed */
function changed(names) {
  spanChanged();
  if (names.every((name) => name === "a" || name === "b")) {
    picture.resize();
    values.read();
    return;
  }
  describe();
  clearTimeout(settling);
  settling = setTimeout(() => {
    fetchCurves();
    fetchEvents();
  }, SETTLE_MS);
}

function spanChanged() {
  trends.range = view.range();
  const ages = view.live ? view.series.map((key) => /** @type {const} */ ([key, silenceOf(unitOf(key))])) : [];
  trends.silent = new Map(ages.filter(([, age]) => age));
  picture.move();
  showControls(root, trends);
}

/** Put the cursor where a person has put it by a key or a press on what happened, and announce what is read there.
 * @param {number} seconds */
function put(seconds) {
  picture.point(seconds);
  document.getElementById("trend-announcement").textContent = valuesText(trends.curves, seconds);
}

/** @param {number | null} at */
function moved(at) {
  trends.at = at;
  values.read();
}

// --- what is shown ------------------------------------------------------------------------------------------

function drawAll() {
  const empty = unread(trends.curves, trends.range, now());
  trends.unknown = [empty.before, empty.after].filter((span) => span !== null);
  picture.draw();
  values.draw();
  describe();
  const [brighten, remove] = [document.getElementById("trend-brighten"), document.getElementById("trend-remove")];
  brighten.disabled = remove.disabled = !trends.dimmed.size;
  document.getElementById("trend-unread").textContent = unreadText(empty);
  document.getElementById("trend-past").textContent = pastText();
  document.getElementById("trend-summary").textContent = summaryText(trends);
  requestAnimationFrame(() => {
    // The curves are on their way to the screen. The first time is what benchmarks/history.py measures.
    if (!root.dataset.drawn) performance.mark("trends-drawn");
    root.dataset.drawn = String(Date.now());
  });
}

/** No moment that passes while one looks: a live view is described by its length. */
function describe() {
  const [from, to] = trends.range;
  const begins = view.live && view.from === null && !view.preset ? length(view.span) : formatTime(from, "minute");
  const ends = view.live ? words.live : formatTime(to, "minute");
  document.getElementById("trend-span").textContent = `${begins} – ${ends} · ${fineness(trends)}`;
}

/** In words, where a part of the chart is empty. @param {{ before: Span | null, after: Span | null }} empty */
function unreadText({ before, after }) {
  /** @param {number} at */
  const time = (at) => shortTime(at, trends.range[1]);
  if (before && trends.curves.every(({ t }) => !t.length))
    return words.none.replace("{from}", shortTime(before[0], before[1])).replace("{to}", shortTime(before[1], before[0]));
  const since = before ? words.unreadBefore.replace("{time}", time(before[1])) : "";
  const until = after ? words.unreadAfter.replace("{time}", time(after[0])) : "";
  return [since, until].filter(Boolean).join(" ");
}

/** What the dotted lines are, and that there are none where that time has no readings. */
function pastText() {
  const { compared, past } = trends;
  const isEmpty = past.length > 0 && past.every(({ avg }) => avg.every((value) => value === null));
  return [compared?.name, isEmpty ? words.pastEmpty : ""].filter(Boolean).join(". ");
}

/** A browser's own words for a request that came to nothing are in its language, not in the page's. @param {unknown} error */
function why(error) {
  const text = error instanceof TypeError ? words.noResponse : /** @type {Error} */ (error).message;
  return words.fault.replace("{n}", text);
}

/** @param {string} fault */
function explain(fault) {
  document.getElementById("trend-fault").textContent = fault;
}

view.addEventListener("change", (event) => changed(/** @type {CustomEvent<string[]>} */ (event).detail));
bindControls(root, trends, explain, drawAll);
bindGestures(document.getElementById("trend-picture"), trends, (x) => picture.timeAt(x), put);
bindNotes(words, () => view.a ?? trends.at ?? now(), fetchEvents, why);
for (const media of MEDIA) matchMedia(media).addEventListener("change", () => picture.recolour());
new MutationObserver(() => picture.recolour()).observe(document.documentElement, { attributeFilter: ["data-theme"] });
showControls(root, trends);
const first = fetchCurves();
first.finally(fetchEvents);
first.then(fetchWindows).then(
  (found) => {
    catalogue.windows = found;
    picture.draw();
  },
  () => {},
);
setInterval(beat, BEAT_MS);
// What every page has comes after the picture, or without it when the history is slow.
Promise.race([first, new Promise((late) => setTimeout(late, REST_WAITS_MS))]).finally(async () => {
  await import("./main.js");
  ({ silenceOf } = await import("./quality.js"));
});
