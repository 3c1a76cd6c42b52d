import { formatTime } from "./site-time.js";
// Alarms in a lane above the curves: the shape and number of its priority where each begins, and a line while it was active.

const SIZE = 18;
/** Height of a row of their lane. */
export const ROW = 22;
/** By priority, the most important first; `shape`: corners as parts of its size, none: a disc.
 * @type {Record<string, AlarmLook>} */
const LOOKS = {
  urgent: {
    number: "1",
    fill: "--urgent",
    ink: "--urgent-ink",
    line: "--urgent",
    shape: [
      [0.3, 0],
      [0.7, 0],
      [1, 0.3],
      [1, 0.7],
      [0.7, 1],
      [0.3, 1],
      [0, 0.7],
      [0, 0.3],
    ],
  },
  high: {
    number: "2",
    fill: "--high",
    ink: "--high-ink",
    line: "--high",
    shape: [
      [0.5, 0],
      [1, 1],
      [0, 1],
    ],
  },
  medium: {
    number: "3",
    fill: "--medium",
    ink: "--medium-ink",
    line: "--medium",
    shape: [
      [0.5, 0],
      [1, 0.5],
      [0.5, 1],
      [0, 0.5],
    ],
  },
  low: { number: "4", fill: "--low", ink: "--low-ink", line: "--low", shape: [] },
};

/** Where each alarm of a span is drawn: `row` counts the priorities that occur, the most important at the top; `x`
 * and `until` are places of `place(seconds)`, within the span. The most important is drawn last, over others.
 * @param {Alarm[]} alarms @param {Span} span @param {(seconds: number) => number} place */
export function placed(alarms, [from, to], place) {
  const shown = alarms.filter((alarm) => alarm.t < to && (alarm.until ?? to) > from);
  const priorities = Object.keys(LOOKS).filter((priority) => shown.some((alarm) => alarm.priority === priority));
  return shown
    .map((alarm) => ({
      ...LOOKS[alarm.priority],
      row: priorities.indexOf(alarm.priority),
      x: place(Math.max(from, alarm.t)),
      until: place(Math.min(to, alarm.until ?? to)),
    }))
    .sort((a, b) => b.row - a.row || a.x - b.x);
}

/** How many rows the alarms of a span take; at least one, so that the chart does not move with the first.
 * @param {Alarm[]} alarms @param {Span} span */
export const alarmRows = (alarms, span) => Math.max(1, ...placed(alarms, span, Number).map(({ row }) => row + 1));

/** Draw them into their lane, from `top` on, in pixels of the canvas. `colour` gives a name of tokens.css as the canvas
 * understands it.
 * @param {uPlot} plot @param {Alarm[]} alarms @param {Span} range @param {number} top
 * @param {(name: string) => string} colour */
export function drawAlarms(plot, alarms, range, top, colour) {
  const { ctx } = plot;
  const size = SIZE * devicePixelRatio;
  const row = ROW * devicePixelRatio;
  ctx.save();
  ctx.setLineDash([]);
  ctx.textAlign = "center";
  ctx.textBaseline = "middle";
  ctx.font = `700 ${11 * devicePixelRatio}px sans-serif`;
  for (const each of placed(alarms, range, (seconds) => plot.valToPos(seconds, "x", true))) {
    const y = top + each.row * row + (row - size) / 2;
    ctx.strokeStyle = colour(each.line);
    ctx.lineWidth = 4 * devicePixelRatio;
    ctx.beginPath();
    ctx.moveTo(each.x, y + size / 2);
    ctx.lineTo(each.until, y + size / 2);
    ctx.stroke();
    outline(ctx, each.shape, each.x - size / 2, y, size);
    ctx.fillStyle = colour(each.fill);
    ctx.fill();
    ctx.strokeStyle = colour("--line-strong");
    ctx.lineWidth = devicePixelRatio;
    ctx.stroke();
    ctx.fillStyle = colour(each.ink);
    ctx.fillText(each.number, each.x, y + size * (each.number === "2" ? 0.68 : 0.54));
  }
  ctx.restore();
}

/** @param {CanvasRenderingContext2D} ctx @param {[number, number][]} shape @param {number} x @param {number} y
 * @param {number} size */
function outline(ctx, shape, x, y, size) {
  ctx.beginPath();
  if (shape.length) for (const [across, down] of shape) ctx.lineTo(x + across * size, y + down * size);
  else ctx.arc(x + size / 2, y + size / 2, size / 2, 0, 2 * Math.PI);
  ctx.closePath();
}

/** An alarm in a list. `words` has the priorities and `active`.
 * @param {Alarm} alarm @param {TrendWords} words */
export function alarmContent({ t, until, priority, place, name }, words) {
  const mark = document.createElement("span");
  mark.className = "alarm-priority alarm-priority--word";
  mark.dataset.is = priority;
  const shape = document.createElement("i");
  shape.className = "alarm-priority__shape";
  shape.ariaHidden = "true";
  mark.append(shape, words[priority] ?? "");
  const end = until === null ? words.active : formatTime(until);
  return [mark, `${formatTime(t)} – ${end} · ${place && `${place} · `}${name}`];
}
