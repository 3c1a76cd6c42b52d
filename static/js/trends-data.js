// Asks the history and puts the answers into one table for uPlot.
import { iso } from "./trends-view.js";

const HISTORY = "/api/v1/history";
/** uPlot.join: null is a hole and stays one; what is missing because another value has a time there is no hole. */
const RETAIN_NULLS = 1;
/** The page's clock and the server's, and the time that the scripts took. */
const FIRST_WITHIN_S = 10;

async function get(path, query, signal) {
  return answered(await fetch(`${HISTORY}${path}?${query}`, { signal }));
}

async function answered(response) {
  if (response.ok) return response.json();
  const problem = await response.json().catch(() => ({}));
  throw new Error(problem.detail ?? response.status);
}

const spanOf = ([from, to]) => ({ from: iso(from), to: iso(Math.max(to, from + 0.001)) });

/** For each value named `{t, min, max, avg, decimals, bucket_s, …}`, times in seconds. */
export function fetchSeries(names, range, points, signal) {
  if (!names.length) return Promise.resolve([]);
  const early = takeFirst(names, range);
  if (early) return fetch(early, { signal }).then(answered);
  const query = new URLSearchParams({ ...spanOf(range), points, format: "epoch" });
  for (const name of names) query.append("series", name);
  return get("/series", query, signal);
}

/** Where the answer is that the page asked for while its scripts were on the way; once, and only if it is the
 * one wanted. */
function takeFirst(names, [from, to]) {
  const link = document.getElementById("trend-first");
  if (!link) return null;
  link.remove();
  const asked = new URL(link.href).searchParams;
  const near = (name, at) => Math.abs(Date.parse(asked.get(name)) / 1000 - at) < FIRST_WITHIN_S;
  const same = asked.getAll("series").join() === names.join() && near("from", from) && near("to", to);
  return same ? link.href : null;
}

/** What happened over the span: `{marks: [{t, what, …}], more}`. */
export function fetchMarks(names, range, signal) {
  const query = new URLSearchParams(spanOf(range));
  for (const unit of new Set(names.map((name) => name.slice(0, name.lastIndexOf("/")))))
    query.append("unit", unit);
  return get("/marks", query, signal);
}

export function exportAddress(names, range, file) {
  const query = new URLSearchParams({ ...spanOf(range), format: file });
  for (const name of names) query.append("series", name);
  return `${HISTORY}/export?${query}`;
}

/** One table: times, then for each answer average, least and greatest, each through `shift`. */
export function joined(answers, shift = (value) => value) {
  if (!answers.length) return [[]];
  const column = (answer, name, i) => answer[name].map((value) => (value === null ? null : shift(value, i)));
  const tables = answers.map((answer, i) => [
    answer.t,
    ...["avg", "min", "max"].map((name) => column(answer, name, i)),
  ]);
  return uPlot.join(
    tables,
    tables.map((table) => table.map(() => RETAIN_NULLS)),
  );
}

/** What an answer says at a time: its last point before; null in a hole or before its first. */
export function valueAt(answer, at) {
  let low = 0;
  let high = answer.t.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (answer.t[middle] <= at) low = middle + 1;
    else high = middle;
  }
  if (!low) return null;
  const last = low === answer.t.length && at - answer.t[low - 1] > 2 * answer.bucket_s + 15;
  return last ? null : answer.avg[low - 1];
}

/** Least, average and greatest of all that is shown, and the holes in it. */
export function summary(answer) {
  let least = Number.POSITIVE_INFINITY;
  let greatest = Number.NEGATIVE_INFINITY;
  let total = 0;
  let count = 0;
  for (let i = 0; i < answer.t.length; i++) {
    if (answer.avg[i] === null) continue;
    least = Math.min(least, answer.min[i]);
    greatest = Math.max(greatest, answer.max[i]);
    total += answer.avg[i];
    count += 1;
  }
  return count ? { least, greatest, average: total / count, holes: answer.t.length - count } : null;
}
