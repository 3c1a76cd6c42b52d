// What the history and the alarms respond with (app/line/history, app/line/alarms), as the trends page takes it. Times are Unix
// times in seconds.

type Span = [from: number, to: number];
type Hole = null;

/** The newest minutes of one value. */
interface Spark {
  t: number[];
  avg: (number | Hole)[];
}

/** One value over a span, in steps of `bucket_s`; 0: every reading. */
interface Result extends Spark {
  min: (number | Hole)[];
  max: (number | Hole)[];
  bus: string;
  unit: number;
  value: string;
  measure: string;
  decimals: number | null;
  bucket_s: number;
}

/** A result as a line of the chart: the name of its series, what the page calls it, its label beside it,
 * and its place among all.
 * `past`: of the time compared. */
interface Curve extends Result {
  key: string;
  name: string;
  label: string;
  place: number;
  past: boolean;
}

/** What the trends page shows: the view, what was fetched for it, where nothing was read, and where the cursor is. `chosen`: the
 * series whose scale has its axis shown, `dimmed`: those whose lines are, `more`: of which lists there is more, `silent`: how old
 * the last reading is of each series whose unit is silent now. */
interface Trends {
  words: TrendWords;
  catalogue: import("../static/js/trends-view.js").Catalogue;
  view: View;
  range: Span;
  at: number | null;
  chosen: string;
  dimmed: Set<string>;
  curves: Curve[];
  past: Curve[];
  compared: Comparison | null;
  marks: Mark[];
  alarms: Alarm[];
  notes: Note[];
  more: Set<string>;
  unknown: Span[];
  silent: Map<string, string>;
  /** Pixels of the chart, and right of it. */
  room: { chart: number; beside: number };
}

/** What a unit is called, or a bus. */
type NamesPlace = (bus: string, unit: number | null) => string;

/** By how much an earlier span is earlier, in seconds; null where there is none, and `name` is why. */
interface Comparison {
  offset: number | null;
  name: string;
}

/** A note of the API: an ISO time. */
interface StoredNote {
  time: string;
  who: string;
  text: string;
  bus: string | null;
  unit: number | null;
}

interface Note extends StoredNote {
  t: number;
}

/** What a preset shows now: from when, and until when; null: up to now. */
type Preset = (now: number, starts: number[]) => [from: number, to: number | null];

/** What happened, for example an act of a person; `until` is the end of readings that came late, null of all else. */
interface Mark {
  t: number;
  until: number | null;
  bus: string | null;
  unit: number | null;
  who: string | null;
  shown: { what: string; old: string; new: string };
}

/** An alarm while it was active; `until` is null as long as it is. */
interface Alarm {
  t: number;
  until: number | null;
  priority: string;
  name: string;
  place: string;
}

/** What GET /api/v1/line has of a unit and the trends page takes. */
interface UnitWindow {
  id: number;
  decimals: number | null;
  at_speed_window_raw: number | null;
}

interface LineBus {
  name: string;
  units: UnitWindow[];
}

interface CatalogueUnit {
  key: string;
  name: string;
  labels: Record<string, string>;
}

/** The least and the most that a picture shows. */
interface Scale {
  least: number;
  most: number;
}

interface PictureEvents {
  cursor(at: number | null): void;
  selected(from: number, to: number): void;
}

type View = import("../static/js/trends-view.js").View;

/** The time at a place of the window, in pixels from its left edge. */
type TimeAt = (clientX: number) => number;

/** An alarm where it is drawn, in percent of the span; `label`: whose it is and what, `named`: where that stands,
 * `index`: its place in the list. */
interface PlacedAlarm extends Alarm {
  index: number;
  row: number;
  x: number;
  end: number;
  label: string;
  named: Span | null;
}

/** An alarm of the API: ISO times. */
interface Occurrence {
  from: string;
  to: string | null;
  priority: string;
  shown: { name: string; place: string };
}
