// What lies over and above the curves: the lanes of alarms and notes, the events, the cursors A and B, and hatching
// where nothing was read.
import { alarmRows, drawAlarms, ROW } from "./trends-alarms.js";
import { colour, css } from "./trends-look.js";

const GAP = 6;

/** Height of the lanes above the curves, in pixels. @param {Overlay} overlay @param {Span} range */
export const lanesHeight = ({ alarms, notes }, range) => (alarmRows(alarms, range) + (notes.length ? 1 : 0)) * ROW + GAP;

/** The alarm or note at a place above the curves, in pixels from their upper edge and left edge; null where there is
 * none. The nearest that began before counts, and one that begins shortly after.
 * @param {uPlot} plot @param {Overlay} overlay @param {number} x
 * @returns {{ list: "alarms" | "notes", place: number } | null} */
export function laneItem(plot, { alarms, notes }, x) {
  /** @param {"alarms" | "notes"} list @param {{ t: number, until?: number | null }[]} items */
  const near = (list, items) =>
    items.map(({ t, until }, place) => {
      const [start, end] = [plot.valToPos(t, "x"), until === undefined ? null : plot.valToPos(until ?? t, "x")];
      const inside = end !== null && x >= start && x <= end;
      return { list, place, far: inside ? 0 : Math.abs(x - start) };
    });
  const [nearest] = [...near("alarms", alarms), ...near("notes", notes)].sort((a, b) => a.far - b.far);
  return nearest && nearest.far <= ROW ? nearest : null;
}

/** Draw all of it. `unknown`: spans without a reading.
 * @param {uPlot} plot @param {Overlay} overlay @param {Span} range @param {Span[]} unknown @param {LaneWords | null} words
 * null: of the lanes of bits, which have no alarms above them */
export function drawOverlay(plot, overlay, range, unknown, words) {
  const { ctx, bbox } = plot;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left - 1, 0, bbox.width + 2, bbox.top + bbox.height);
  ctx.clip();
  for (const span of unknown) hatch(plot, span);
  ctx.lineWidth = devicePixelRatio;
  ctx.font = `600 ${14 * devicePixelRatio}px ${css("--family")}`;
  for (const { t, until } of overlay.marks)
    if (until === null) line(plot, t, range, "--line-strong", [2, 4]);
    else late(plot, [t, until], words?.late ?? "");
  for (const { t } of overlay.notes) line(plot, t, range, "--text", []);
  for (const name of /** @type {const} */ (["a", "b"]))
    line(plot, overlay[name], range, "--mark-ink", [], name.toUpperCase());
  ctx.restore();
  if (words) drawLanes(plot, overlay, range, words);
}

/** @param {uPlot} plot @param {number | null} at @param {Span} range @param {string} name @param {number[]} dash */
function line({ ctx, bbox, valToPos }, at, [from, to], name, dash, label = "") {
  if (at === null || at < from || at > to) return;
  const x = Math.round(valToPos(at, "x", true)) + 0.5;
  ctx.strokeStyle = ctx.fillStyle = colour(name);
  ctx.setLineDash(dash.map((each) => each * devicePixelRatio));
  ctx.beginPath();
  ctx.moveTo(x, bbox.top);
  ctx.lineTo(x, bbox.top + bbox.height);
  ctx.stroke();
  if (label) ctx.fillText(label, x + 4 * devicePixelRatio, bbox.top + 14 * devicePixelRatio);
}

/** A bar along the time axis: readings that came late.
 * @param {uPlot} plot @param {Span} span @param {string} label */
function late({ ctx, bbox, valToPos }, [from, to], label) {
  const [left, right] = [valToPos(from, "x", true), valToPos(to, "x", true)];
  if (right < bbox.left) return;
  const [height, bottom] = [4 * devicePixelRatio, bbox.top + bbox.height];
  ctx.save();
  ctx.fillStyle = colour("--line-strong");
  ctx.fillRect(left, bottom - height, Math.max(height, right - left), height);
  ctx.fillStyle = colour("--quiet");
  ctx.textAlign = "left";
  const rightmost = bbox.left + bbox.width - ctx.measureText(label).width;
  ctx.fillText(label, Math.min(Math.max(left, bbox.left + height), rightmost), bottom - 2 * height);
  ctx.restore();
}

/** @param {uPlot} plot @param {Span} span */
function hatch({ ctx, bbox, valToPos }, [from, to]) {
  const [left, right] = [valToPos(from, "x", true), valToPos(to, "x", true)];
  const step = 10 * devicePixelRatio;
  ctx.save();
  ctx.beginPath();
  ctx.rect(left, bbox.top, right - left, bbox.height);
  ctx.clip();
  ctx.strokeStyle = colour("--hatch");
  ctx.lineWidth = 2 * devicePixelRatio;
  ctx.beginPath();
  const first = left - (left % step) - bbox.height;
  for (let x = first; x < right; x += step) {
    ctx.moveTo(x, bbox.top + bbox.height);
    ctx.lineTo(x + bbox.height, bbox.top);
  }
  ctx.stroke();
  ctx.restore();
}

/** Before the lane, or within it where the window is too narrow for the word.
 * @param {uPlot} plot @param {string} word @param {number} y */
function nameLane({ ctx, bbox }, word, y) {
  const gap = 8 * devicePixelRatio;
  const fits = ctx.measureText(word).width + gap <= bbox.left;
  ctx.textAlign = fits ? "right" : "left";
  ctx.fillText(word, fits ? bbox.left - gap : bbox.left + gap, y);
}

/** @param {uPlot} plot @param {Overlay} overlay @param {Span} range @param {LaneWords} words */
function drawLanes(plot, { alarms, notes }, range, words) {
  const { ctx, bbox } = plot;
  const row = ROW * devicePixelRatio;
  const rows = alarmRows(alarms, range);
  const top = bbox.top - (rows + (notes.length ? 1 : 0)) * row - GAP * devicePixelRatio;
  ctx.save();
  ctx.textBaseline = "middle";
  ctx.textAlign = "right";
  ctx.font = `${14 * devicePixelRatio}px ${css("--family")}`;
  ctx.fillStyle = colour("--panel");
  ctx.fillRect(bbox.left, top, bbox.width, bbox.top - top - GAP * devicePixelRatio);
  ctx.fillStyle = colour("--quiet");
  nameLane(plot, words.alarms, top + row / 2);
  if (notes.length) nameLane(plot, words.notes, top + (rows + 0.5) * row);
  ctx.beginPath();
  ctx.rect(bbox.left - row / 2, top, bbox.width + row, bbox.top - top);
  ctx.clip();
  drawAlarms(plot, alarms, range, top, colour);
  ctx.textAlign = "center";
  notes.forEach(({ t }, i) => {
    if (t < range[0] || t > range[1]) return;
    flag(plot, plot.valToPos(t, "x", true), top + rows * row, String(i + 1));
  });
  ctx.restore();
}

/** @param {uPlot} plot @param {number} x @param {number} y @param {string} number */
function flag({ ctx }, x, y, number) {
  const height = ROW * devicePixelRatio;
  const half = height * 0.45;
  ctx.fillStyle = colour("--act");
  ctx.beginPath();
  for (const [across, down] of [[-half, 2], [half, 2], [half, height * 0.7], [0, height], [-half, height * 0.7]])
    ctx.lineTo(x + across, y + down);
  ctx.closePath();
  ctx.fill();
  ctx.fillStyle = colour("--act-ink");
  ctx.font = `700 ${11 * devicePixelRatio}px sans-serif`;
  ctx.fillText(number, x, y + height * 0.42);
}
