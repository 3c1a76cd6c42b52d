// The trends page: the view selects, the history responds, the chart and the table show the result.
import { alarmContent } from "./trends-alarms.js";
import { bindControls, showControls } from "./trends-controls.js";
import { fetchAlarms, fetchMarks, fetchSeries } from "./trends-data.js";
import { gestures } from "./trends-gestures.js";
import { Picture } from "./trends-plot.js";
import { clearList, drawCursors, drawList, drawRows, eventContent, fineness, summaryText, valuesText } from "./trends-table.js";
import { formatTime, length } from "./trends-time.js";
import { View } from "./trends-view.js";

const SETTLE_MS = 60;
const BEAT_MS = 1000;
const MARKS_EVERY_S = 15;
const REFRESHES_PER_SPAN = 300;
/** What changes the colours. */
const MEDIA = ["(prefers-color-scheme: dark)", "(forced-colors: active)", "print"];

/** Which values there are, and what each is called. */
export class Catalogue {
  /** @param {CatalogueUnit[]} units @param {Record<string, string>} words by the name of a value */
  constructor(units, words) {
    this.units = new Map(units.map((unit) => [unit.key, unit]));
    this.words = words;
  }

  /** @param {string} name @returns {[CatalogueUnit | undefined, string]} */
  split(name) {
    const cut = name.lastIndexOf("/");
    return [this.units.get(name.slice(0, cut)), name.slice(cut + 1)];
  }

  /** @param {string} name */
  has(name) {
    const [unit, value] = this.split(name);
    return unit !== undefined && value in this.words;
  }

  /** @param {number} count */
  first(count) {
    return [...this.units.keys()].slice(0, count).map((key) => `${key}/actual`);
  }

  /** @param {string} name */
  title(name) {
    const [unit, value] = this.split(name);
    return `${unit?.name} · ${unit?.labels[value] || this.words[value]}`;
  }
}

/** The page as it is open: what was fetched last, and the parts that show it. */
export class TrendsPage {
  constructor() {
    this.root = document.getElementById("trends");
    this.body = document.getElementById("trend-values");
    this.fault = document.getElementById("trend-fault");
    this.words = document.getElementById("trend-words").dataset;
    const { catalogue, valueWords } = this.root.dataset;
    this.catalogue = new Catalogue(JSON.parse(catalogue), JSON.parse(valueWords));
    this.view = new View(this.catalogue);
    /** @type {Cursor} */
    this.cursor = { at: null, put: (seconds) => this.put(seconds) };
    /** @type {Result[]} */
    this.results = [];
    /** @type {string[]} */
    this.names = [];
    /** @type {Mark[]} */
    this.marks = [];
    /** @type {Alarm[]} */
    this.alarms = [];
    this.chosen = 0;
    this.requestedAt = { data: 0, marks: 0 };
    /** @type {AbortController | null} */
    this.pending = null;
    this.settling = 0;
    this.picture = new Picture(
      document.getElementById("trend-plot"),
      document.getElementById("trend-lanes"),
      { cursor: (at) => this.moved(at), selected: (from, to) => this.view.show(from, to) },
      () => this.overlay(),
    );
  }

  /** Show the view and follow it; settled once its curves are drawn or their request has failed. */
  start() {
    const { root, view } = this;
    view.addEventListener("change", (event) => this.changed(/** @type {CustomEvent<string[]>} */ (event).detail));
    bindControls(root, view, this.words, (fault) => this.explain(fault));
    for (const media of MEDIA) matchMedia(media).addEventListener("change", () => this.recolour());
    new MutationObserver(() => this.recolour()).observe(document.documentElement, { attributeFilter: ["data-theme"] });
    gestures(document.getElementById("trend-picture"), view, (x) => this.picture.timeAt(x), this.cursor);
    showControls(root, view);
    const first = this.fetchAll();
    first.finally(() => this.fetchEvents());
    setInterval(() => this.beat(), BEAT_MS);
    return first;
  }

  // --- requests -------------------------------------------------------------------------------------------

  async fetchAll() {
    this.pending?.abort();
    this.pending = new AbortController();
    const wanted = [...this.view.series];
    this.requestedAt.data = Date.now();
    try {
      const found = await fetchSeries(wanted, this.view.range(), this.points(), this.pending.signal);
      this.results = found.map((result, i) => ({ ...result, name: this.catalogue.title(wanted[i]) }));
      this.names = wanted;
      this.explain("");
      this.drawAll();
    } catch (error) {
      if (!(error instanceof DOMException && error.name === "AbortError")) this.showFault(error);
    }
  }

  points() {
    return Math.max(200, Math.min(2000, Math.round(document.getElementById("trend-plot").clientWidth)));
  }

  async fetchEvents() {
    const { view, words } = this;
    this.requestedAt.marks = Date.now();
    try {
      const range = view.range();
      const [found, active] = await Promise.all([fetchMarks(view.series, range), fetchAlarms(view.series, range)]);
      this.marks = found.marks;
      this.alarms = active.alarms;
      this.list("events", found.marks, found.more, eventContent);
      this.list("alarms", active.alarms, active.more, (alarm) => alarmContent(alarm, words));
      this.picture.redraw();
    } catch (error) {
      // None are known, though there may be some.
      this.marks = [];
      this.alarms = [];
      for (const name of /** @type {const} */ (["events", "alarms"])) clearList(...listOf(name));
      this.showFault(error);
    }
  }

  /** Once a second: what follows now moves on, and requests as often as a pixel's worth has passed. */
  beat() {
    if (document.hidden || !this.view.live) return;
    const [from, to] = this.view.range();
    if (this.picture.curves) this.picture.move([from, to]);
    showControls(this.root, this.view);
    const due = Math.max(2000, ((to - from) * 1000) / REFRESHES_PER_SPAN);
    if (Date.now() - this.requestedAt.data >= due) this.fetchAll();
    if (Date.now() - this.requestedAt.marks >= MARKS_EVERY_S * 1000) this.fetchEvents();
  }

  // --- changes --------------------------------------------------------------------------------------------

  /** @param {string[]} names of what the view has changed */
  changed(names) {
    showControls(this.root, this.view);
    if (names.every((name) => name === "a" || name === "b")) {
      this.picture.redraw();
      this.moved(this.cursor.at);
      return;
    }
    if (this.picture.curves) this.picture.move(this.view.range());
    this.describe();
    this.refetch();
  }

  refetch() {
    clearTimeout(this.settling);
    this.settling = setTimeout(() => {
      this.fetchAll();
      this.fetchEvents();
    }, SETTLE_MS);
  }

  /** Where a person has put the cursor by a key or a press on what happened, which is also announced.
   * @param {number} seconds */
  put(seconds) {
    this.picture.point(seconds);
    document.getElementById("trend-announcement").textContent = valuesText(this.results, seconds);
  }

  /** @param {number | null} at */
  moved(at) {
    this.cursor.at = at;
    drawCursors(this.body, this.results, { at, a: this.view.a, b: this.view.b });
  }

  /** @param {number} place */
  choose(place) {
    this.chosen = place;
    this.drawAll();
  }

  recolour() {
    this.picture.forget();
    this.drawAll();
  }

  // --- the parts ------------------------------------------------------------------------------------------

  drawAll() {
    const { view } = this;
    this.picture.draw(this.results, view.range(), view.scale, this.chosen);
    drawRows(this.body, this.results, this.names, {
      remove: (name) => view.remove(name),
      choose: (place) => this.choose(place),
    });
    this.moved(this.cursor.at);
    this.describe();
    document.getElementById("trend-summary").textContent = summaryText(this.results);
    requestAnimationFrame(() => this.shownToPeople());
  }

  /** The curves are on their way to the screen. The first time is what benchmarks/history.py measures. */
  shownToPeople() {
    if (!this.root.dataset.drawn) performance.mark("trends-drawn");
    this.root.dataset.drawn = String(Date.now());
  }

  overlay() {
    const { a, b, marks } = this.view;
    return { marks: marks ? this.marks : [], alarms: marks ? this.alarms : [], a, b };
  }

  /** No moment that passes while one looks: a live view is described by its length. */
  describe() {
    const { view, words } = this;
    const [from, to] = view.range();
    const begins = view.live && view.from === null ? length(view.span) : formatTime(from);
    document.getElementById("trend-span").textContent =
      `${begins} – ${view.live ? words.live : formatTime(to)} · ${fineness(this.results)}`;
  }

  /** @template {Mark | Alarm} T @param {"events" | "alarms"} name @param {T[]} items @param {boolean} more
   * @param {Content<T>} content */
  list(name, items, more, content) {
    drawList(...listOf(name), { items, more }, content, this.cursor.put);
  }

  /** A browser's own words for a request that came to nothing are in its language, not in the page's.
   * @param {unknown} error */
  showFault(error) {
    const why = error instanceof TypeError ? this.words.noResponse : /** @type {Error} */ (error).message;
    this.explain(this.words.fault.replace("{n}", why));
  }

  /** @param {string} fault */
  explain(fault) {
    this.fault.textContent = fault;
  }
}

/** @param {"events" | "alarms"} name @returns {[list: HTMLElement, count: HTMLElement]} */
const listOf = (name) => [
  document.getElementById(`trend-${name}-list`),
  document.getElementById(`trend-${name}-count`),
];
