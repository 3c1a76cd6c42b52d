// What a span is compared with: an earlier one of the same length, by how many seconds it is earlier.
import { formatTime } from "./site-time.js";
import { fetchRecipeRuns } from "./trends-data.js";
import { dayBefore, shiftAt } from "./trends-time.js";

/** By how much the earlier span is earlier, and what it is called; `offset` null where there is none, and `name` is why.
 * @param {View} view @param {Span} range @param {TrendWords} words @returns {Promise<Comparison | null>} */
export async function comparison({ compare, starts, series }, [from, to], words) {
  if (compare === "day") return { offset: from - dayBefore(from), name: words.yesterday };
  if (compare === "shift") {
    const [start] = shiftAt(from, starts);
    return { offset: start - shiftAt(start - 1, starts)[0], name: words.before };
  }
  if (compare !== "recipe" || !series.length) return null;
  const runs = await fetchRecipeRuns(series[0].split("/")[0], to);
  if (!runs) return { offset: null, name: words.norun };
  const moment = formatTime(runs.before, "dayClock");
  return { offset: runs.loaded - runs.before, name: words.run.replace("{name}", runs.name).replace("{time}", moment) };
}

/** A result of an earlier span, as if it were of this one. @param {Curve} curve @param {number} offset @returns {Curve} */
export const moved = (curve, offset) => ({ ...curve, past: true, t: curve.t.map((at) => at + offset) });
