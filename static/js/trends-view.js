// The view: which values over which span. It is the page's address, so a link reopens the same view.
import { now } from "./clock.js";
import { iso } from "./history-requests.js";
import { dayStart, shiftAt } from "./trends-time.js";

const MIN_SPAN = 1;
const MAX_SPAN = 12 * 365 * 86400;
const DEFAULT_SPAN = 3600;
const DEFAULT_VALUES = 8;
export const MAX_VALUES = 32;
/** The shift that is under way, up to now, the one before it, and the day before. @type {Record<string, Preset>} */
const PRESETS = {
  shift: (now, starts) => [shiftAt(now, starts)[0], null],
  before: (now, starts) => shiftAt(shiftAt(now, starts)[0] - 1, starts),
  yesterday: (now) => [dayStart(dayStart(now) - 1), dayStart(now)],
};
/** What a view can be compared with. */
const COMPARISONS = ["day", "shift", "recipe"];

/** A view: `series` ("bus/unit/value"), `scale` shared or own, `marks`, cursors `a` and `b` (or null), `compare`
 * with what, and one of a `preset`, `span` seconds up to now, `from` up to now, or `from` … `to`. */
export class View extends EventTarget {
  /** `starts`: when shifts start, in minutes after midnight.
   * @param {{ has(name: string): boolean, first(count: number): string[] }} catalogue @param {number[]} starts */
  constructor(catalogue, starts) {
    super();
    this.starts = starts;
    const query = new URLSearchParams(location.search);
    /** @param {string} name */
    const moment = (name) => Date.parse(query.get(name) ?? "") / 1000;
    this.series = query
      .getAll("s")
      .filter((name) => catalogue.has(name))
      .slice(0, MAX_VALUES);
    if (!query.has("s")) this.series = [...catalogue.first(DEFAULT_VALUES)];
    this.scale = query.get("scale") === "own" ? "own" : "shared";
    this.marks = query.get("marks") !== "0";
    this.preset = oneOf(query.get("preset"), Object.keys(PRESETS));
    this.compare = oneOf(query.get("compare"), COMPARISONS);
    this.a = numberOr(moment("a"), null);
    this.b = numberOr(moment("b"), null);
    this.from = numberOr(moment("from"), null);
    this.to = numberOr(moment("to"), null);
    if (this.from !== null && this.to !== null && this.to <= this.from) this.from = this.to = null;
    this.span = clamp(numberOr(Number(query.get("span")), DEFAULT_SPAN) || DEFAULT_SPAN);
  }

  get live() {
    return this.preset ? this.preset === "shift" : this.to === null;
  }

  /** The span shown now, seconds since the epoch.
   * @returns {Span} */
  range(end = now()) {
    if (this.preset) {
      const [from, to] = PRESETS[this.preset](end, this.starts);
      return [from, to ?? end];
    }
    if (this.to !== null) return [this.from ?? this.to - this.span, this.to];
    return [this.from ?? end - this.span, end];
  }

  /** @param {number} span */
  follow(span) {
    this.change({ span: clamp(span), from: null, to: null, preset: "" });
  }

  /** Show the shift under way, or the one before. @param {string} preset */
  showPreset(preset) {
    this.change({ from: null, to: null, preset });
  }

  /** @param {number} from @param {number} to */
  show(from, to) {
    const middle = (from + to) / 2;
    const half = clamp(to - from) / 2;
    this.change({ from: middle - half, to: middle + half, preset: "" });
  }

  /** Closer (factor < 1) or wider around a time; what follows now goes on doing so when it widens around now.
   * @param {number} factor @param {number} [around] */
  zoom(factor, around) {
    const [from, to] = this.range();
    const centre = around ?? (this.live ? to : (from + to) / 2);
    if (this.live && around === undefined) this.follow((to - from) * factor);
    else this.show(centre - (centre - from) * factor, centre + (to - centre) * factor);
  }

  /** By parts of the span, later when positive; past now it follows now.
   * @param {number} parts */
  pan(parts) {
    const [from, to] = this.range();
    const by = (to - from) * parts;
    if (to + by >= now()) this.follow(to - from);
    else this.show(from + by, to + by);
  }

  toggleLive() {
    const [from, to] = this.range();
    if (this.live) this.show(from, to);
    else this.follow(to - from);
  }

  /** @param {string} name */
  add(name) {
    if (!this.series.includes(name) && this.series.length < MAX_VALUES)
      this.change({ series: [...this.series, name] });
  }

  /** @param {string[]} names */
  remove(...names) {
    this.change({ series: this.series.filter((name) => !names.includes(name)) });
  }

  /** @param {Partial<View>} what */
  change(what) {
    Object.assign(this, what);
    history.replaceState(null, "", `?${this.query()}`);
    this.dispatchEvent(new CustomEvent("change", { detail: Object.keys(what) }));
  }

  /** The address that shows the same times whenever it is opened. */
  link() {
    const query = this.query();
    for (const name of ["preset", "span"]) query.delete(name);
    const [from, to] = this.range();
    query.set("from", iso(from));
    query.set("to", iso(to));
    return `${location.origin}${location.pathname}?${query}`;
  }

  query() {
    const query = new URLSearchParams();
    for (const name of this.series) query.append("s", name);
    if (!this.series.length) query.append("s", "");
    if (this.preset) query.set("preset", this.preset);
    else if (this.from === null && this.to === null)
      query.set("span", String(Math.round(this.span * 1000) / 1000));
    for (const [name, at] of Object.entries({ from: this.from, to: this.to, a: this.a, b: this.b }))
      if (at !== null) query.set(name, iso(at));
    if (this.scale === "own") query.set("scale", "own");
    if (!this.marks) query.set("marks", "0");
    if (this.compare) query.set("compare", this.compare);
    return query;
  }
}

/** @param {number} span */
const clamp = (span) => Math.min(MAX_SPAN, Math.max(MIN_SPAN, span));
/** @template T @param {number} value @param {T} otherwise */
const numberOr = (value, otherwise) => (Number.isFinite(value) ? value : otherwise);
/** @param {string | null} text @param {string[]} known */
const oneOf = (text, known) => (text && known.includes(text) ? text : "");
