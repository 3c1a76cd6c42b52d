// The history's response, as the chart and its table read it: a gap stays a gap.
import assert from "node:assert/strict";
import { test } from "node:test";
import uPlot from "uplot";
import { openPage } from "./page.js";

globalThis.uPlot = uPlot;
openPage();
const { fetchMarks } = await import("../../static/js/history-requests.js");
const { endValue, exportAddress, fetchSeries, joined, summary, unread, valueAt } = await import(
  "../../static/js/trends-data.js"
);

const response = (t, avg, more = {}) => ({ t, avg, min: avg, max: avg, bucket_s: 1, ...more });
const columns = (table) => table.map((column) => [...column]);

test("values of different times share one axis, and a hole reaches to the points beside it", () => {
  const table = joined([response([1, 2, 4], [10, null, 30]), response([1, 3], [7, 8])]);
  assert.deepEqual(columns([table[0], table[1], table[4]]), [
    [1, 2, 3, 4],
    [10, null, null, 30],
    [7, undefined, 8, undefined],
  ]);
  assert.equal(table.length, 7);
});

test("average, least and greatest are each shifted, holes are not", () => {
  const one = { ...response([1, 2], [5, null]), min: [4, null], max: [6, null] };
  assert.deepEqual(columns(joined([one], (value, place) => value + 100 + place)), [
    [1, 2],
    [105, null],
    [104, null],
    [106, null],
  ]);
  assert.deepEqual(joined([]), [[]]);
});

test("a value holds from its time to the next one", () => {
  const one = response([10, 20, 30], [1, null, 3]);
  assert.deepEqual([9, 10, 19.9, 20, 30].map((time) => valueAt(one, time)), [null, 1, 1, null, 3]);
});

test("the last value holds for two of its intervals and 15 s", () => {
  const one = response([10], [1], { bucket_s: 5 });
  assert.deepEqual([valueAt(one, 35), valueAt(one, 35.1)], [1, null]);
  assert.equal(valueAt(response([], []), 5), null);
});

test("a unit that is silent now has no latest value, and one that was read before the end of a past span has", () => {
  const one = response([10, 20], [1, 2]);
  assert.deepEqual([endValue(one, [0, 100], 30), endValue(one, [0, 100], 60), endValue(one, [0, 25], 60)], [2, null, 2]);
});

test("a summary leaves holes out and counts them", () => {
  const one = { t: [1, 2, 3], avg: [4, null, 8], min: [2, null, 7], max: [5, null, 9] };
  assert.deepEqual(summary(one), { least: 2, greatest: 9, average: 6, holes: 1 });
  assert.equal(summary(response([1, 2], [null, null])), null);
});

const RANGE = [1_700_000_000, 1_700_000_060];
const FROM = "2023-11-14T22%3A13%3A20.000Z";
const TO = "2023-11-14T22%3A14%3A20.000Z";

/** Respond to every request so, and return the list of requested addresses. */
function serve(found, ok = true, status = 200) {
  const requested = [];
  globalThis.fetch = async (address) => {
    requested.push(String(address));
    return { ok, status, json: async () => found };
  };
  return requested;
}

test("a series is requested by its span, its points and its names", async () => {
  const requested = serve([{ t: [] }]);
  assert.deepEqual(await fetchSeries(["line/1/actual", "line/2/run"], RANGE, 500), [{ t: [] }]);
  const names = "series=line%2F1%2Factual&series=line%2F2%2Frun";
  assert.deepEqual(requested, [`/api/v1/history/series?from=${FROM}&to=${TO}&points=500&format=epoch&${names}`]);
});

test("without a name nothing is requested", async () => {
  const requested = serve([]);
  assert.deepEqual(await fetchSeries([], RANGE, 500), []);
  assert.deepEqual(requested, []);
});

test("a refusal is an error in the server's words, else its status", async () => {
  serve({ detail: "too many points" }, false, 422);
  await assert.rejects(fetchSeries(["a/1/b"], RANGE, 1), { message: "too many points" });
  globalThis.fetch = async () => ({ ok: false, status: 502, json: () => Promise.reject(new SyntaxError()) });
  await assert.rejects(fetchSeries(["a/1/b"], RANGE, 1), { message: "502" });
});

test("events are requested once for each unit", async () => {
  const requested = serve({ marks: [], more: false });
  await fetchMarks(["line/1/actual", "line/1/run", "wet/2/actual"], RANGE);
  assert.deepEqual(requested, [`/api/v1/history/marks?from=${FROM}&to=${TO}&unit=line%2F1&unit=wet%2F2&format=epoch`]);
});

test("an export is of what is shown, and never of an empty span", () => {
  const address = exportAddress(["line/1/actual"], RANGE, "csv");
  assert.equal(address, `/api/v1/history/export?from=${FROM}&to=${TO}&format=csv&layout=table&form=reader&series=line%2F1%2Factual`);
  const moment = new URLSearchParams(exportAddress([], [RANGE[0], RANGE[0]], "csv").split("?")[1]);
  assert.equal(Date.parse(moment.get("to")) - Date.parse(moment.get("from")), 1);
});

test("a part of a span without readings is named, up to now", () => {
  const read = (t) => [response(t, t), response([], [])];
  assert.deepEqual(unread(read([60, 99]), [0, 100], 200), { before: [0, 60], after: null });
  assert.deepEqual(unread(read([0, 30]), [0, 100], 200), { before: null, after: [47, 100] });
  assert.deepEqual(unread(read([0, 30]), [0, 100], 40), { before: null, after: null });
  assert.deepEqual(unread(read([]), [0, 100], 50), { before: [0, 50], after: null });
  assert.deepEqual(unread([], [0, 100], 50), { before: null, after: null }, "nothing is chosen");
});
