// The names of lines at their ends, right of the chart, one below the other where they would touch.
import { colour, css } from "./trends-look.js";

const HEIGHT = 17;
const INSET = 16;
const MIN_NAME = 53;

/** Where labels of a height stand that want to be at `wanted`, in order of these, within a span: each as near as the
 * others allow, those that would touch around their middle; none overlaps another as long as there is room.
 * @param {number[]} wanted @param {number} height @param {Span} span */
export function apart(wanted, height, [top, bottom]) {
  const order = wanted.map((_, place) => place).sort((a, b) => wanted[a] - wanted[b] || a - b);
  /** @type {{ first: number, sum: number, count: number }[]} */
  const groups = [];
  order.forEach((place, rank) => {
    let group = { first: rank, sum: wanted[place] - rank * height, count: 1 };
    for (let above = groups.at(-1); above && above.sum / above.count > group.sum / group.count; above = groups.at(-1)) {
      groups.pop();
      group = { first: above.first, sum: above.sum + group.sum, count: above.count + group.count };
    }
    groups.push(group);
  });
  const found = [...wanted];
  for (const { first, sum, count } of groups) {
    const base = Math.max(top, Math.min(sum / count, bottom - (order.length - 1) * height));
    for (let rank = first; rank < first + count; rank++) found[order[rank]] = base + rank * height;
  }
  return found;
}

/** Write them, each tied to the height at which its line ends: by a hair in gray, which is no part of the line.
 * @param {uPlot} plot @param {LineEnd[]} ends @param {number} width of the space right of the chart, in pixels */
export function drawLabels(plot, ends, width) {
  const { ctx, bbox } = plot;
  const ratio = devicePixelRatio;
  const wanted = ends.map(({ value, scale }) => plot.valToPos(value, scale, true));
  const places = apart(wanted, HEIGHT * ratio, [bbox.top + (HEIGHT / 2) * ratio, bbox.top + bbox.height]);
  const edge = bbox.left + bbox.width;
  ctx.save();
  ctx.font = `600 ${14 * ratio}px ${css("--family")}`;
  ctx.textAlign = "left";
  ctx.textBaseline = "middle";
  ctx.lineWidth = ratio;
  ctx.strokeStyle = colour("--quiet");
  ctx.setLineDash([]);
  ends.forEach(({ label, place, dimmed }, i) => {
    ctx.beginPath();
    ctx.moveTo(edge, wanted[i]);
    ctx.lineTo(edge + (INSET - 4) * ratio, places[i]);
    ctx.stroke();
    ctx.fillStyle = colour(dimmed ? "--quiet" : "--text");
    ctx.fillText(shortened(ctx, `${place + 1} ${label}`, (width - INSET) * ratio), edge + INSET * ratio, places[i]);
  });
  ctx.restore();
}

/** A text that fits into so many pixels of a canvas: a number alone where a name would not.
 * @param {CanvasRenderingContext2D} ctx @param {string} text @param {number} width */
function shortened(ctx, text, width) {
  if (width < MIN_NAME * devicePixelRatio) return text.split(" ")[0];
  if (ctx.measureText(text).width <= width) return text;
  let letters = text.length - 1;
  while (letters > 2 && ctx.measureText(`${text.slice(0, letters)}…`).width > width) letters--;
  return `${text.slice(0, letters)}…`;
}
