// Requests the history, and works out from its results what the chart, the table and the texts show.
import { get, HISTORY, iso, json, spanOf, unitQuery } from "./history-requests.js";
import { formatTime } from "./site-time.js";
import { dayBefore, shiftAt } from "./trends-time.js";

/** uPlot.join: null is a hole, up to the points beside it, whatever times other values have in between. What else is
 * missing because another value has a time there is no hole. */
const EXPAND_NULLS = 2;
/** How long the last reading stands for what is now, seconds. */
const STILL_S = 15;
/** The part of a span without readings that is worth a line of text. */
const UNREAD_PART = 0.02;
const COLUMNS = /** @type {const} */ (["avg", "min", "max"]);

/** For each value named `{t, min, max, avg, decimals, bucket_s, …}`, times in seconds.
 * @param {string[]} names @param {Span} range @param {number} points @param {AbortSignal} [signal]
 * @returns {Promise<Result[]>} */
export function fetchSeries(names, range, points, signal) {
  if (!names.length) return Promise.resolve([]);
  const query = new URLSearchParams({ ...spanOf(range), points: String(points), format: "epoch" });
  for (const name of names) query.append("series", name);
  return get("/series", query, signal);
}

/** The at-speed window of each unit "bus/unit" in what it displays, with its decimals.
 * @returns {Promise<Map<string, UnitWindow>>} */
export async function fetchWindows() {
  const { buses } = await json(await fetch("/api/v1/line"));
  return new Map(
    /** @type {LineBus[]} */ (buses).flatMap(({ name, units }) => units.map((unit) => [`${name}/${unit.id}`, unit])),
  );
}

/** The notes that people wrote about a time of the span. @param {string[]} names @param {Span} range
 * @returns {Promise<Note[]>} */
export async function fetchNotes(names, range) {
  const { notes } = await json(await fetch(`/api/v1/shifts/notes?${unitQuery(names, range)}`));
  return /** @type {StoredNote[]} */ (notes).map((note) => ({ ...note, t: Date.parse(note.time) / 1000 }));
}

/** Write a note about a time of the site, or of a unit "bus/unit". Repeated with the same key it is stored once.
 * @param {{ time: number, text: string, unit: string, key: string }} note */
export async function writeNote({ time, text, unit, key }) {
  const [bus, number] = [unit.slice(0, unit.lastIndexOf("/")), unit.slice(unit.lastIndexOf("/") + 1)];
  const place = unit ? { bus, unit: Number(number) } : {};
  const headers = { "Content-Type": "application/json", "Idempotency-Key": key };
  const body = JSON.stringify({ time: iso(time), text, ...place });
  await json(await fetch("/api/v1/shifts/notes", { method: "POST", headers, body }));
}

/** What a span is compared with: by how much that is earlier, and what it is called; `offset` null where there is none, and
 * `name` is why. @param {View} view @param {Span} range @param {TrendWords} words @returns {Promise<Comparison | null>} */
export async function comparison({ compare, starts, series }, [from, to], words) {
  if (compare === "day") return { offset: from - dayBefore(from), name: words.yesterday };
  if (compare === "shift") {
    const [start] = shiftAt(from, starts);
    return { offset: start - shiftAt(start - 1, starts)[0], name: words.before };
  }
  if (compare !== "recipe" || !series.length) return null;
  const address = `/api/v1/buses/${encodeURIComponent(series[0].split("/")[0])}/recipe/runs`;
  const runs = await json(await fetch(`${address}?${new URLSearchParams({ at: iso(to) })}`));
  if (!runs?.before) return { offset: null, name: words.norun };
  const [loaded, before] = [runs.loaded, runs.before].map((time) => Date.parse(time) / 1000);
  const name = words.run.replace("{name}", runs.name).replace("{time}", formatTime(before, "dayClock"));
  return { offset: loaded - before, name };
}

/** `file`: "csv" for a spreadsheet, "data" for programs, or "parquet".
 * @param {string[]} names @param {Span} range @param {string} file */
export function exportAddress(names, range, file) {
  const query = new URLSearchParams({ ...spanOf(range), format: file === "data" ? "csv" : file });
  if (file === "csv") {
    query.set("layout", "table");
    query.set("form", "reader");
  }
  for (const name of names) query.append("series", name);
  return `${HISTORY}/export?${query}`;
}

/** One table: times, then for each result average, least and greatest, each through `shift`.
 * @param {Result[]} results @param {(value: number, place: number, column: number) => number} [shift] @returns {uPlot.AlignedData} */
export function joined(results, shift = (value) => value) {
  if (!results.length) return [[]];
  const tables = results.map((result, i) => [
    result.t,
    ...COLUMNS.map((name, column) => result[name].map((value) => (value === null ? null : shift(value, i, column)))),
  ]);
  return uPlot.join(
    /** @type {uPlot.AlignedData[]} */ (tables),
    tables.map((table) => table.map(() => EXPAND_NULLS)),
  );
}

/** The value of a result at a time: its last point before; null in a gap or before its first.
 * @param {Result} result @param {number} at */
export function valueAt({ t, avg, bucket_s }, at) {
  const last = t.findLastIndex((each) => each <= at);
  const isOld = last === t.length - 1 && at - t[last] > 2 * bucket_s + STILL_S;
  return last < 0 || isOld ? null : avg[last];
}

/** The value of a result at the end of a span, or now where it has not ended; null in a gap there.
 * @param {Result} result @param {Span} span @param {number} now */
export const endValue = (result, [, to], now) => valueAt(result, Math.min(to, now));

/** The last value of a result within a span, null where there is none. @param {Result} result @param {Span} span */
export function lastValue({ t, avg }, [from, to]) {
  const last = t.findLastIndex((at, i) => at <= to && avg[i] !== null);
  return t[last] >= from ? avg[last] : null;
}

/** The part of a span, up to now, before the first of all readings, and the part after the last, where it is a
 * notable part of it. With no reading at all: all of it; with no value: none.
 * @param {Result[]} results @param {Span} range @param {number} now @returns {{ before: Span | null, after: Span | null }} */
export function unread(results, [from, to], now) {
  const end = Math.min(to, now);
  const read = results.filter(({ t }) => t.length);
  const first = Math.min(...read.map(({ t }) => t[0]));
  const last = Math.max(...read.map(({ t, bucket_s }) => t[t.length - 1] + 2 * bucket_s + STILL_S));
  if (!results.length) return { before: null, after: null };
  if (first > end) return { before: [from, end], after: null };
  const notable = (to - from) * UNREAD_PART;
  return { before: first - from > notable ? [from, first] : null, after: end - last > notable ? [last, end] : null };
}

/** Least, average and greatest of all that is shown, and the holes in it. @param {Result} result */
export function summary({ avg, min, max }) {
  const [averages, lows, highs] = [avg, min, max].map((column) => column.filter((value) => value !== null));
  if (!averages.length) return null;
  const average = averages.reduce((sum, value) => sum + value, 0) / averages.length;
  return { least: Math.min(...lows), greatest: Math.max(...highs), average, holes: avg.length - averages.length };
}
