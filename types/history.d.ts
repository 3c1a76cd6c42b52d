// What the history and the alarms respond with (app/history, app/alarms), as the trends page takes it. Times are Unix
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
  /** As the page calls it. */
  name: string;
}

/** What happened, for example an act of a person. */
interface Mark {
  t: number;
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

/** The nodes of one item of a list. */
type Content<T> = (item: T) => (string | Node)[];

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

/** The times of the cursors, null where one is not set. */
interface Cursors {
  at: number | null;
  a: number | null;
  b: number | null;
}

/** Drawn over the curves. */
interface Overlay {
  marks: Mark[];
  alarms: Alarm[];
  a: number | null;
  b: number | null;
}

interface PictureEvents {
  cursor(at: number | null): void;
  selected(from: number, to: number): void;
}

/** `barefoot`: without labels below, because lanes are there; `lanes`: how many it has, 0 for curves. */
interface PlotShape {
  margin: { left: number; right: number };
  barefoot?: boolean;
  lanes?: number;
}

interface RowActions {
  remove(name: string): void;
  choose(place: number): void;
}

/** The cursor of the picture; `put` moves it and announces what the values read there. */
interface Cursor {
  at: number | null;
  put(seconds: number): void;
}

type View = import("../static/js/trends-view.js").View;

/** The time at a place of the window, in pixels from its left edge. */
type TimeAt = (clientX: number) => number;

/** How the alarms of a priority are drawn; `shape`: corners as parts of the size, none: a disc. Colours by name. */
interface AlarmLook {
  number: string;
  fill: string;
  ink: string;
  line: string;
  shape: [number, number][];
}

/** An alarm of the API: ISO times. */
interface Occurrence {
  from: string;
  to: string | null;
  priority: string;
  shown: { name: string; place: string };
}
