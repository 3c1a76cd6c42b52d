// Requests to the history, of charts and of the unit page: marks and alarms of a span.

export const HISTORY = "/api/v1/history";

/** @param {number} seconds */
export const iso = (seconds) => new Date(Math.round(seconds * 1000)).toISOString();

/** @param {string} path @param {URLSearchParams} query @param {AbortSignal} [signal] */
export async function get(path, query, signal) {
  return json(await fetch(`${HISTORY}${path}?${query}`, { signal }));
}

/** @param {Response} response */
export async function json(response) {
  if (response.ok) return response.json();
  const problem = await response.json().catch(() => ({}));
  throw new Error(problem.detail ?? response.status);
}

/** @param {Span} span */
export const spanOf = ([from, to]) => ({ from: iso(from), to: iso(Math.max(to, from + 0.001)) });

/** What happened over the span: `{marks: [{t, until, what, …}], more}`.
 * @param {string[]} names @param {Span} range @returns {Promise<{ marks: Mark[], more: boolean }>} */
export function fetchMarks(names, range) {
  const query = unitQuery(names, range);
  query.append("format", "epoch");
  return get("/marks", query);
}

/** The alarms that were active over the span: `{alarms: [{t, until, priority, name, place}], more}`, times in
 * seconds, `until` null while one is active.
 * @param {string[]} names @param {Span} range @returns {Promise<{ alarms: Alarm[], more: boolean }>} */
export async function fetchAlarms(names, range) {
  const { occurrences, more } = await json(await fetch(`/api/v1/alarms/occurrences?${unitQuery(names, range)}`));
  const alarms = /** @type {Occurrence[]} */ (occurrences).map(({ from, to, priority, shown }) => ({
    t: Date.parse(from) / 1000,
    until: to === null ? null : Date.parse(to) / 1000,
    priority,
    ...shown,
  }));
  return { alarms, more };
}

/** @param {string[]} names @param {Span} range */
export function unitQuery(names, range) {
  const query = new URLSearchParams(spanOf(range));
  for (const unit of new Set(names.map((name) => name.slice(0, name.lastIndexOf("/")))))
    query.append("unit", unit);
  return query;
}
