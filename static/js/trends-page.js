// The trends page: the view selects, the history responds, the chart, the legend and the table show the result.
import { now } from "./clock.js";
import { fetchAlarms, fetchMarks } from "./history-requests.js";
import { formatTime } from "./site-time.js";
import { Catalogue } from "./trends-catalogue.js";
import { comparison, moved } from "./trends-compare.js";
import { bindControls, showControls } from "./trends-controls.js";
import { fetchNotes, fetchSeries, unread } from "./trends-data.js";
import { gestures } from "./trends-gestures.js";
import { Legend } from "./trends-legend.js";
import { isBit } from "./trends-look.js";
import { bindNotes, noteContent } from "./trends-notes.js";
import { Picture } from "./trends-plot.js";
import { alarmContent, clearList, drawCursors, drawList, drawRows, eventContent, fineness, summaryText, valuesText } from "./trends-table.js";
import { length, shortTime } from "./trends-time.js";
import { View } from "./trends-view.js";

const SETTLE_MS = 60;
const BEAT_MS = 1000;
const MARKS_EVERY_S = 15;
const REFRESHES_PER_SPAN = 300;
/** What changes the colors. */
const MEDIA = ["(prefers-color-scheme: dark)", "(forced-colors: active)", "print"];
const LISTS = /** @type {const} */ (["events", "alarms", "notes"]);

/** The page as it is open: what was fetched last, and the parts that show it. */
export class TrendsPage {
  constructor() {
    this.root = document.getElementById("trends");
    this.body = document.getElementById("trend-values");
    this.fault = document.getElementById("trend-fault");
    this.words = document.getElementById("trend-words").dataset;
    const { catalogue, valueWords, shiftStarts } = this.root.dataset;
    this.catalogue = new Catalogue(JSON.parse(catalogue), JSON.parse(valueWords));
    this.view = new View(this.catalogue, JSON.parse(shiftStarts));
    /** @type {Cursor} */
    this.cursor = { at: null, put: (seconds) => this.put(seconds) };
    /** @type {Curve[]} */
    this.results = [];
    /** The same of the time compared. @type {Curve[]} */
    this.past = [];
    /** @type {Comparison | null} */
    this.compared = null;
    /** The series whose lines are dimmed. @type {Set<string>} */
    this.dimmed = new Set();
    /** @type {Mark[]} */
    this.marks = [];
    /** @type {Alarm[]} */
    this.alarms = [];
    /** @type {Note[]} */
    this.notes = [];
    this.chosen = 0;
    this.requestedAt = { data: 0, marks: 0 };
    /** @type {AbortController | null} */
    this.pending = null;
    this.settling = 0;
    const [list, time] = [document.getElementById("trend-legend"), document.getElementById("trend-at")];
    this.legend = new Legend(list, time, this.words, { toggle: (key) => this.dim(key), only: (key) => this.dimOthers(key) });
    this.picture = new Picture(
      document.getElementById("trend-plot"),
      document.getElementById("trend-lanes"),
      { cursor: (at) => this.moved(at), selected: (from, to) => this.view.show(from, to) },
      () => this.overlay(),
      { alarms: this.words.alarms, notes: this.words.notes, late: this.words.late },
    );
  }

  /** Show the view and follow it; settled once its curves are drawn or their request has failed. */
  start() {
    const { root, view } = this;
    view.addEventListener("change", (event) => this.changed(/** @type {CustomEvent<string[]>} */ (event).detail));
    bindControls(root, view, this.words, (fault) => this.explain(fault));
    bindLegendButtons(this);
    bindNotes(this.words, () => view.a ?? this.cursor.at ?? now(), () => this.fetchEvents(), (error) => this.why(error));
    for (const media of MEDIA) matchMedia(media).addEventListener("change", () => this.recolour());
    new MutationObserver(() => this.recolour()).observe(document.documentElement, { attributeFilter: ["data-theme"] });
    const picture = document.getElementById("trend-picture");
    gestures(picture, view, (x) => this.picture.timeAt(x), this.cursor, (event) => this.openItem(event));
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
      const labels = this.catalogue.labels(wanted);
      this.results = found.map((result, i) => ({ ...this.curve(result, wanted[i], i), label: labels[i] }));
      this.explain("");
      this.drawAll();
    } catch (error) {
      if (!(error instanceof DOMException && error.name === "AbortError")) this.explain(this.why(error));
    }
  }

  /** @param {Result} result @param {string} key @param {number} place @returns {Curve} */
  curve(result, key, place) {
    const name = this.catalogue.title(key);
    return { ...result, key, place, name, label: name, dimmed: this.dimmed.has(key), past: false };
  }

  points() {
    return Math.max(200, Math.min(2000, Math.round(document.getElementById("trend-plot").clientWidth)));
  }

  /** What happened in the span, and what it is compared with. */
  async fetchEvents() {
    const { view, words } = this;
    this.requestedAt.marks = Date.now();
    try {
      const range = view.range();
      const [found, active, notes] = await Promise.all([
        fetchMarks(view.series, range),
        fetchAlarms(this.catalogue.withNeighbors(view.series), range),
        fetchNotes(view.series, range),
        this.fetchPast(range),
      ]);
      this.marks = found.marks;
      this.alarms = active.alarms;
      this.notes = notes;
      const place = this.catalogue.place.bind(this.catalogue);
      this.list("events", found.marks, found.more, (mark) => eventContent(mark, place));
      this.list("alarms", active.alarms, active.more, (alarm) => alarmContent(alarm, words));
      this.list("notes", notes, false, (note) => noteContent(note, notes.indexOf(note), place));
      this.drawAll();
    } catch (error) {
      // None are known, though there may be some.
      [this.marks, this.alarms, this.notes, this.past] = [[], [], [], []];
      for (const name of LISTS) clearList(...listOf(name));
      this.explain(this.why(error));
    }
  }

  /** The span compared is requested with as much more as passes until it is requested again.
   * @param {Span} range */
  async fetchPast(range) {
    const { view } = this;
    this.compared = await comparison(view, range, this.words);
    const offset = this.compared?.offset ?? null;
    const wanted = view.series.filter((key) => !isBit({ value: this.catalogue.split(key)[1] }));
    if (offset === null) {
      this.past = [];
      return;
    }
    const earlier = /** @type {Span} */ ([range[0] - offset, range[1] - offset + MARKS_EVERY_S]);
    const found = await fetchSeries(wanted, earlier, this.points());
    this.past = found.map((result, i) => moved(this.curve(result, wanted[i], view.series.indexOf(wanted[i])), offset));
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
    this.legend.show(at, this.view.range());
    drawCursors(this.body, this.results, { a: this.view.a, b: this.view.b });
  }

  /** @param {number} place */
  choose(place) {
    this.chosen = place;
    this.drawAll();
  }

  /** Dim the line of a series, or end that. @param {string} key */
  dim(key) {
    if (!this.dimmed.delete(key)) this.dimmed.add(key);
    this.dimmedChanged();
  }

  /** Dim all lines but one, or none where they are. @param {string} key */
  dimOthers(key) {
    const others = this.view.series.filter((other) => other !== key);
    const areDimmed = !this.dimmed.has(key) && others.every((other) => this.dimmed.has(other));
    this.dimmed = new Set(areDimmed ? [] : others);
    this.dimmedChanged();
  }

  dimmedChanged() {
    for (const curve of [...this.results, ...this.past]) curve.dimmed = this.dimmed.has(curve.key);
    this.drawAll();
  }

  recolour() {
    this.picture.forget();
    this.drawAll();
  }

  /** Open the list at the alarm or note that was pressed above the curves; whether one was.
   * @param {MouseEvent} event */
  openItem({ target }) {
    const item = /** @type {HTMLElement} */ (target).closest("[data-list]");
    if (!item) return false;
    const [list] = listOf(/** @type {"alarms" | "notes"} */ (item.dataset.list));
    /** @type {HTMLDetailsElement} */ (list.closest("details")).open = true;
    list.querySelectorAll("button")[Number(item.dataset.index)]?.focus();
    return true;
  }

  // --- the parts ------------------------------------------------------------------------------------------

  drawAll() {
    const { view } = this;
    const range = view.range();
    const empty = unread(this.results, range, now());
    const unknown = [empty.before, empty.after].filter((span) => span !== null);
    this.picture.draw([...this.past, ...this.results], range, unknown, view.scale, this.chosen);
    this.picture.redraw();
    this.legend.draw(this.results, this.past);
    drawRows(this.body, this.results, {
      remove: (name) => view.remove(name),
      choose: (place) => this.choose(place),
    });
    this.moved(this.cursor.at);
    this.describe();
    this.writeUnread(empty, range);
    document.getElementById("trend-past").textContent = this.pastText();
    for (const button of document.querySelectorAll("[data-dimmed]")) /** @type {HTMLButtonElement} */ (button).disabled = !this.dimmed.size;
    document.getElementById("trend-summary").textContent = summaryText(this.results);
    requestAnimationFrame(() => this.shownToPeople());
  }

  /** What the dotted lines are, and that there are none where that time has no readings. */
  pastText() {
    const { compared, past, words } = this;
    const isEmpty = past.length > 0 && past.every(({ avg }) => avg.every((value) => value === null));
    return [compared?.name, isEmpty ? words.pastEmpty : ""].filter(Boolean).join(". ");
  }

  /** The curves are on their way to the screen. The first time is what benchmarks/history.py measures. */
  shownToPeople() {
    if (!this.root.dataset.drawn) performance.mark("trends-drawn");
    this.root.dataset.drawn = String(Date.now());
  }

  overlay() {
    const { a, b, marks } = this.view;
    const { alarms, notes } = this;
    return marks ? { marks: this.marks, alarms, notes, a, b } : { marks: [], alarms: [], notes: [], a, b };
  }

  /** No moment that passes while one looks: a live view is described by its length. */
  describe() {
    const { view, words } = this;
    const [from, to] = view.range();
    const begins = view.live && view.from === null && !view.preset ? length(view.span) : formatTime(from, "minute");
    document.getElementById("trend-span").textContent =
      `${begins} – ${view.live ? words.live : formatTime(to, "minute")} · ${fineness(this.results)}`;
  }

  /** In words, where a part of the chart is empty.
   * @param {{ before: Span | null, after: Span | null }} empty @param {Span} range */
  writeUnread({ before, after }, [, to]) {
    const { words } = this;
    const none = this.results.length > 0 && this.results.every(({ t }) => !t.length);
    /** @type {string[]} */
    const texts = [];
    if (none && before)
      texts.push(words.none.replace("{from}", shortTime(before[0], to)).replace("{to}", shortTime(before[1], to)));
    else if (before) texts.push(words.unreadBefore.replace("{time}", shortTime(before[1], to)));
    if (after) texts.push(words.unreadAfter.replace("{time}", shortTime(after[0], to)));
    document.getElementById("trend-unread").textContent = texts.join(" ");
  }

  /** @template {Mark | Alarm | Note} T @param {"events" | "alarms" | "notes"} name @param {T[]} items
   * @param {boolean} more @param {Content<T>} content */
  list(name, items, more, content) {
    drawList(...listOf(name), { items, more }, content, this.cursor.put);
  }

  /** A browser's own words for a request that came to nothing are in its language, not in the page's.
   * @param {unknown} error */
  why(error) {
    const why = error instanceof TypeError ? this.words.noResponse : /** @type {Error} */ (error).message;
    return this.words.fault.replace("{n}", why);
  }

  /** @param {string} fault */
  explain(fault) {
    this.fault.textContent = fault;
  }
}

/** Below the legend: what is dimmed is shown again or removed, and the view as a link is copied. @param {TrendsPage} page */
function bindLegendButtons(page) {
  const { root, view, words } = page;
  root.addEventListener("click", ({ target }) => {
    const dimmed = target.closest("[data-dimmed]")?.dataset.dimmed;
    if (dimmed === "remove") view.remove(...page.dimmed);
    if (dimmed) page.dimmed.clear();
    if (dimmed) page.dimmedChanged();
    if (!target.closest("#trend-copy")) return;
    // Without https a browser has no clipboard but the selection of a field.
    const link = document.getElementById("trend-link");
    link.value = view.link();
    link.hidden = false;
    link.select();
    const isCopied = document.execCommand("copy");
    link.hidden = isCopied;
    document.getElementById("trend-copied").textContent = isCopied ? words.copied : "";
  });
}

/** @param {"events" | "alarms" | "notes"} name @returns {[list: HTMLElement, count: HTMLElement]} */
const listOf = (name) => [
  document.getElementById(`trend-${name}-list`),
  document.getElementById(`trend-${name}-count`),
];
