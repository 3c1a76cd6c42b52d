// The trends page: the view selects, the history responds, the chart and the table show the result.
import { alarmContent } from "./trends-alarms.js";
import { exportAddress, fetchAlarms, fetchMarks, fetchSeries } from "./trends-data.js";
import { gestures } from "./trends-gestures.js";
import { Picture } from "./trends-plot.js";
import { clearList, drawCursors, drawList, drawRows, eventContent, fineness, summaryText, valuesText } from "./trends-table.js";
import { fromField, length, formatTime, toField } from "./trends-time.js";
import { MOST_VALUES, View } from "./trends-view.js";

const SETTLE_MS = 60;
const REST_WAITS_MS = 1000;
const BEAT_MS = 1000;
const MARKS_EVERY_S = 15;
const REFRESHES_PER_SPAN = 300;
const byId = (id) => document.getElementById(id);
const root = byId("trends");
const words = byId("trend-words").dataset;

/** Which values there are, and what each is called. */
class Catalogue {
  constructor() {
    this.units = new Map(JSON.parse(root.dataset.catalogue).map((unit) => [unit.key, unit]));
    this.words = JSON.parse(root.dataset.valueWords);
  }

  split(name) {
    const cut = name.lastIndexOf("/");
    return [this.units.get(name.slice(0, cut)), name.slice(cut + 1)];
  }

  has(name) {
    const [unit, value] = this.split(name);
    return unit !== undefined && value in this.words;
  }

  first(count) {
    return [...this.units.keys()].slice(0, count).map((key) => `${key}/actual`);
  }

  title(name) {
    const [unit, value] = this.split(name);
    return `${unit.name} · ${unit.labels[value] || this.words[value]}`;
  }
}

const catalogue = new Catalogue();
const view = new View(catalogue);
const body = byId("trend-values");
const cursor = { at: null, put };
let results = [];
let names = [];
let marks = [];
let alarms = [];
let chosen = 0;
const requestedAt = { data: 0, marks: 0 };
let pending = null;

const picture = new Picture(
  byId("trend-plot"),
  byId("trend-lanes"),
  { cursor: moved, selected: (from, to) => view.show(from, to) },
  () => ({ marks: view.marks ? marks : [], alarms: view.marks ? alarms : [], a: view.a, b: view.b }),
);

/** Where a person has put the cursor by a key or a press on what happened, which is also announced. */
function put(seconds) {
  picture.point(seconds);
  byId("trend-announcement").textContent = valuesText(results, seconds);
}

function moved(at) {
  cursor.at = at;
  drawCursors(body, results, { at, a: view.a, b: view.b });
}

function points() {
  return Math.max(200, Math.min(2000, Math.round(byId("trend-plot").clientWidth)));
}

async function fetchAll() {
  pending?.abort();
  pending = new AbortController();
  const range = view.range();
  const wanted = [...view.series];
  requestedAt.data = Date.now();
  try {
    const found = await fetchSeries(wanted, range, points(), pending.signal);
    results = found.map((result, i) => ({ ...result, name: catalogue.title(wanted[i]) }));
    names = wanted;
    byId("trend-fault").textContent = "";
    drawAll();
  } catch (error) {
    if (error.name !== "AbortError") showFault(error);
  }
}

/** A browser's own words for a request that came to nothing are in its language, not in the page's. */
function showFault(error) {
  const why = error instanceof TypeError ? words.noResponse : error.message;
  byId("trend-fault").textContent = words.fault.replace("{n}", why);
}

async function fetchEvents() {
  requestedAt.marks = Date.now();
  try {
    const range = view.range();
    const [found, active] = await Promise.all([fetchMarks(view.series, range), fetchAlarms(view.series, range)]);
    marks = found.marks;
    alarms = active.alarms;
    list("events", marks, found.more, eventContent);
    list("alarms", alarms, active.more, (alarm) => alarmContent(alarm, words));
    picture.redraw();
  } catch (error) {
    // None are known, though there may be some.
    marks = alarms = [];
    for (const name of ["events", "alarms"]) clearList(byId(`trend-${name}-list`), byId(`trend-${name}-count`));
    showFault(error);
  }
}

function list(name, items, more, content) {
  drawList(byId(`trend-${name}-list`), byId(`trend-${name}-count`), { items, more }, content, cursor.put);
}

function drawAll() {
  picture.draw(results, view.range(), view.scale, chosen);
  drawRows(body, results, names, { remove: (name) => view.remove(name), choose });
  moved(cursor.at);
  describe();
  byId("trend-summary").textContent = summaryText(results);
  requestAnimationFrame(shownToPeople);
}

/** The curves are on their way to the screen. The first time is what benchmarks/history.py measures. */
function shownToPeople() {
  if (!root.dataset.drawn) performance.mark("trends-drawn");
  root.dataset.drawn = String(Date.now());
}

function choose(place) {
  chosen = place;
  drawAll();
}

let settling = 0;
function refetch() {
  clearTimeout(settling);
  settling = setTimeout(() => {
    fetchAll();
    fetchEvents();
  }, SETTLE_MS);
}

function showControls() {
  const [from, to] = view.range();
  for (const button of root.querySelectorAll("[data-span]"))
    button.setAttribute(
      "aria-pressed",
      String(view.live && view.from === null && Number(button.dataset.span) === view.span),
    );
  for (const button of root.querySelectorAll("[data-preset]"))
    button.setAttribute("aria-pressed", String(view.isPreset(button.dataset.preset)));
  root.querySelector("[data-move=live]").setAttribute("aria-pressed", String(view.live));
  const exact = byId("trend-exact").elements;
  if (!byId("trend-exact").contains(document.activeElement)) {
    exact.from.value = toField(from);
    exact.to.value = toField(to);
  }
  byId("trend-scale").value = view.scale;
  byId("trend-marks").checked = view.marks;
  for (const file of ["csv", "parquet"]) {
    const link = byId(`export-${file}`);
    if (link) link.href = exportAddress(view.series, [from, to], file);
  }
}

/** No moment that passes while one looks: a live view is described by its length. */
function describe() {
  const [from, to] = view.range();
  const begins = view.live && view.from === null ? length(view.span) : formatTime(from);
  byId("trend-span").textContent =
    `${begins} – ${view.live ? words.live : formatTime(to)} · ${fineness(results)}`;
}

view.addEventListener("change", ({ detail }) => {
  showControls();
  if (detail.every((name) => name === "a" || name === "b")) {
    picture.redraw();
    moved(cursor.at);
    return;
  }
  if (picture.curves) picture.move(view.range());
  describe();
  refetch();
});

/** Once a second: what follows now moves on, and requests as often as a pixel's worth has passed. */
function beat() {
  if (document.hidden || !view.live) return;
  const [from, to] = view.range();
  if (picture.curves) picture.move([from, to]);
  showControls();
  const due = Math.max(2000, ((to - from) * 1000) / REFRESHES_PER_SPAN);
  if (Date.now() - requestedAt.data >= due) fetchAll();
  if (Date.now() - requestedAt.marks >= MARKS_EVERY_S * 1000) fetchEvents();
}

const MOVES = {
  back: () => view.pan(-0.5),
  on: () => view.pan(0.5),
  in: () => view.zoom(0.5),
  out: () => view.zoom(2),
  live: () => view.toggleLive(),
};

root.addEventListener("click", ({ target }) => {
  const button = target.closest("[data-span], [data-preset], [data-move]");
  if (!button) return;
  const { span, preset, move } = button.dataset;
  if (span) view.follow(Number(span));
  else if (preset) view.preset(preset);
  else MOVES[move]();
});
byId("trend-exact").addEventListener("submit", (event) => {
  event.preventDefault();
  const { from, to } = event.target.elements;
  const [start, end] = [fromField(from.value), fromField(to.value)];
  if (end > start) view.show(start, end);
  byId("trend-fault").textContent = end > start ? "" : words.backwards;
});
byId("trend-scale").addEventListener("change", ({ target }) => view.change({ scale: target.value }));
byId("trend-marks").addEventListener("change", ({ target }) => view.change({ marks: target.checked }));
byId("trend-add").addEventListener("submit", (event) => {
  event.preventDefault();
  const { unit, value } = event.target.elements;
  if (view.series.length >= MOST_VALUES) byId("trend-fault").textContent = words.full;
  else view.add(`${unit.value}/${value.value}`);
});
for (const media of ["(prefers-color-scheme: dark)", "(forced-colors: active)", "print"])
  matchMedia(media).addEventListener("change", recolour);
new MutationObserver(recolour).observe(document.documentElement, { attributeFilter: ["data-theme"] });

function recolour() {
  picture.forget();
  drawAll();
}

gestures(byId("trend-picture"), view, (x) => picture.timeAt(x), cursor);
showControls();
const first = fetchAll();
first.finally(fetchEvents);
// What every page has comes after the picture, or without it when the history is slow.
Promise.race([first, new Promise((late) => setTimeout(late, REST_WAITS_MS))]).finally(() => import("./main.js"));
setInterval(beat, BEAT_MS);
