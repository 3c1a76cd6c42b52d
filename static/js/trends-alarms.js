// Alarms in a lane above the curves: the shape and number of its priority where each begins, a line while it was active,
// and whose it is.
import { formatTime } from "./site-time.js";
import { css } from "./trends-look.js";

const SIZE = 18;
/** Height of a row of their lane. */
export const ROW = 22;
/** By priority, the most important first; `shape`: an outline within 1 × 1.
 * @type {Record<string, AlarmLook>} */
const LOOKS = {
  urgent: { number: "1", fill: "--urgent", ink: "--urgent-ink", shape: "M.3 0H.7L1 .3V.7L.7 1H.3L0 .7V.3Z" },
  high: { number: "2", fill: "--high", ink: "--high-ink", shape: "M.5 0 1 1H0Z" },
  medium: { number: "3", fill: "--medium", ink: "--medium-ink", shape: "M.5 0 1 .5 .5 1 0 .5Z" },
  low: { number: "4", fill: "--low", ink: "--low-ink", shape: "M0 .5A.5 .5 0 0 1 1 .5 .5 .5 0 0 1 0 .5Z" },
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
      place: alarm.place,
      row: priorities.indexOf(alarm.priority),
      x: place(Math.max(from, alarm.t)),
      until: place(Math.min(to, alarm.until ?? to)),
      label: [alarm.place, alarm.name].filter(Boolean).join(" · "),
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
  const marks = placed(alarms, range, (seconds) => plot.valToPos(seconds, "x", true));
  for (const each of marks) {
    const y = top + each.row * row + (row - size) / 2;
    ctx.strokeStyle = colour(each.fill);
    ctx.lineWidth = 4 * devicePixelRatio;
    ctx.beginPath();
    ctx.moveTo(each.x, y + size / 2);
    ctx.lineTo(each.until, y + size / 2);
    ctx.stroke();
    const outline = new Path2D();
    outline.addPath(new Path2D(each.shape), new DOMMatrix([size, 0, 0, size, each.x - size / 2, y]));
    ctx.fillStyle = colour(each.fill);
    ctx.fill(outline);
    ctx.strokeStyle = colour("--line-strong");
    ctx.lineWidth = devicePixelRatio;
    ctx.stroke(outline);
    ctx.fillStyle = colour(each.ink);
    ctx.fillText(each.number, each.x, y + size * (each.number === "2" ? 0.68 : 0.54));
    nameMark(plot, each, marks, y + size / 2, colour("--text"));
  }
  ctx.restore();
}

/** Write whose alarm it is beside its mark, where that fits before the next of its row.
 * @param {uPlot} plot @param {PlacedAlarm} mark @param {PlacedAlarm[]} marks @param {number} y @param {string} ink */
function nameMark({ ctx, bbox }, mark, marks, y, ink) {
  const start = Math.max(mark.x + SIZE * devicePixelRatio, mark.until + 4 * devicePixelRatio);
  const others = marks.filter((other) => other !== mark && other.row === mark.row && other.x >= mark.x).map(({ x }) => x - SIZE * devicePixelRatio);
  const width = Math.min(bbox.left + bbox.width, ...others) - start;
  ctx.save();
  ctx.font = `${14 * devicePixelRatio}px ${css("--family")}`;
  ctx.textAlign = "left";
  ctx.fillStyle = ink;
  const fits = [mark.label, mark.place].find((text) => text && ctx.measureText(text).width <= width);
  if (fits) ctx.fillText(fits, start, y);
  ctx.restore();
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
