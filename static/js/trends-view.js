// What is shown: which of all values over which span. It is the page's address, so a link reopens the same view.
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

/** Which values there are, and what each is called. */
export class Catalogue {
  /** @param {CatalogueUnit[]} units @param {Record<string, string>} words by the name of a value */
  constructor(units, words) {
    this.units = new Map(units.map((unit) => [unit.key, unit]));
    this.words = words;
    /** @type {Map<string, UnitWindow>} */
    this.windows = new Map();
  }

  /** How far a unit may be from a commanded speed and is at speed; 0 of other values, and where it is not known.
   * @param {{ key: string, value: string, decimals: number | null }} result */
  window({ key, value, decimals }) {
    const known = value === "commanded" ? this.windows.get(unitOf(key)) : undefined;
    return known && known.decimals === decimals ? (known.at_speed_window_raw ?? 0) / 10 ** (decimals ?? 0) : 0;
  }

  /** @param {string} name @returns {[CatalogueUnit | undefined, string]} */
  split(name) {
    return [this.units.get(unitOf(name)), name.slice(name.lastIndexOf("/") + 1)];
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

  /** What each of some lines is called beside it: its unit alone where all show the same value. @param {string[]} names */
  labels(names) {
    const isSame = new Set(names.map((name) => this.split(name)[1])).size === 1;
    return names.map((name) => (isSame ? (this.split(name)[0]?.name ?? name) : this.title(name)));
  }

  /** The values, and one of each unit beside theirs on its line: what happens there is seen here. @param {string[]} names */
  withNeighbors(names) {
    const keys = [...this.units.keys()];
    const shown = new Set(names.map(unitOf));
    const beside = keys.filter((key, i) =>
      [keys[i - 1], keys[i + 1]].some((other) => shown.has(other) && unitOf(other) === unitOf(key)),
    );
    return [...names, ...beside.map((key) => `${key}/actual`)];
  }

  /** A unit by its name, or a bus. @param {string} bus @param {number | null} unit */
  place(bus, unit) {
    return unit === null ? bus : (this.units.get(`${bus}/${unit}`)?.name ?? `${bus}/${unit}`);
  }
}

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
    const moment = (name) => Date.parse(query.get(name) ?? "") / 1000 || null;
    const named = query.getAll("s").filter((name) => catalogue.has(name));
    this.series = query.has("s") ? named.slice(0, MAX_VALUES) : catalogue.first(DEFAULT_VALUES);
    this.scale = query.get("scale") === "own" ? "own" : "shared";
    this.marks = query.get("marks") !== "0";
    this.preset = oneOf(query.get("preset"), Object.keys(PRESETS));
    this.compare = oneOf(query.get("compare"), COMPARISONS);
    this.a = moment("a");
    this.b = moment("b");
    this.from = moment("from");
    this.to = moment("to");
    if (this.from !== null && this.to !== null && this.to <= this.from) this.from = this.to = null;
    this.span = clamp(Number(query.get("span")) || DEFAULT_SPAN);
  }

  get live() {
    return this.preset ? this.preset === "shift" : this.to === null;
  }

  /** The span shown now, seconds since the epoch. @returns {Span} */
  range(end = now()) {
    const [from, to] = this.preset ? PRESETS[this.preset](end, this.starts) : [this.from, this.to];
    return [from ?? (to ?? end) - this.span, to ?? end];
  }

  /** @param {number} span */
  follow(span) {
    this.change({ span: clamp(span), from: null, to: null, preset: "" });
  }

  /** @param {string} preset */
  showPreset(preset) {
    this.change({ from: null, to: null, preset });
  }

  /** @param {number} from @param {number} to */
  show(from, to) {
    const [middle, half] = [(from + to) / 2, clamp(to - from) / 2];
    this.change({ from: middle - half, to: middle + half, preset: "" });
  }

  /** Closer (factor < 1) or wider around a time; what follows now goes on doing so when it widens around now.
   * @param {number} factor @param {number} [around] */
  zoom(factor, around) {
    const [from, to] = this.range();
    const centre = around ?? (from + to) / 2;
    if (this.live && around === undefined) this.follow((to - from) * factor);
    else this.show(centre - (centre - from) * factor, centre + (to - centre) * factor);
  }

  /** By parts of the span, later when positive; past now it follows now. @param {number} parts */
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
    if (!this.series.includes(name) && this.series.length < MAX_VALUES) this.change({ series: [...this.series, name] });
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
    const { series, preset, scale, compare } = this;
    const query = new URLSearchParams((series.length ? series : [""]).map((name) => ["s", name]));
    const [from, to, a, b] = [this.from, this.to, this.a, this.b].map((at) => (at === null ? "" : iso(at)));
    const span = preset || from || to ? "" : String(Math.round(this.span * 1000) / 1000);
    const parts = { preset, span, from, to, a, b, scale: scale === "own" ? scale : "", marks: this.marks ? "" : "0", compare };
    for (const [name, text] of Object.entries(parts)) if (text) query.set(name, text);
    return query;
  }
}

/** A series without its value, or a unit without its number. @param {string} [name] */
export const unitOf = (name = "") => name.slice(0, name.lastIndexOf("/"));
/** @param {number} span */
const clamp = (span) => Math.min(MAX_SPAN, Math.max(MIN_SPAN, span));
/** @param {string | null} text @param {string[]} known */
const oneOf = (text, known) => (text && known.includes(text) ? text : "");
