// The picture: curves with their bands above, bits as lanes below, one time axis for both.
import { zone } from "./clock.js";
import { drawAlarms } from "./trends-alarms.js";
import { joined } from "./trends-data.js";
import { axisLabels, axisNumbers } from "./trends-time.js";

const CURVES = 8;
const DASHES = [[], [8, 4], [2, 3], [10, 3, 2, 3]];
const LANE = 30;
const LANE_FILL = 0.7;
const MIN_HEIGHT = 260;
/** Widths left and right of the curves, so that the lanes below stand under them. */
const GUTTER = 84;
const GUTTER_WIDE = 168;
const LABEL = 20;
const PAD = 16;
const NARROW = 700;
/** How much of a curve's colour its band has, percent. */
const BAND = 20;
const LETTER = 7;
const SYNC = "trends";
const INVISIBLE = "rgb(0 0 0 / 0)";
/** @param {string} name */
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** @type {Map<string, string>} */
const colours = new Map();

/** A colour that light-dark() gives, as the canvas understands it; `percent` of it, the rest shines through. To
 * find one out costs a computation of style, and every mark needs one at every redraw.
 * @param {string} name */
function colour(name, percent = 100) {
  const key = `${name} ${percent}`;
  const found = colours.get(key) ?? foundColour(name, percent);
  colours.set(key, found);
  return found;
}

/** @param {string} name @param {number} percent */
function foundColour(name, percent) {
  const probe = document.createElement("i");
  const color = css(name) ? `var(${name})` : "currentcolor";
  probe.style.color = percent < 100 ? `color-mix(in srgb, ${color} ${percent}%, transparent)` : color;
  document.body.append(probe);
  const found = getComputedStyle(probe).color;
  probe.remove();
  return found;
}

/** Hue and dash of the value at a place: 32 values differ in one of the two.
 * @param {number} place */
export function look(place) {
  return {
    name: `--curve-${(place % CURVES) + 1}`,
    dash: DASHES[Math.floor(place / CURVES) % DASHES.length],
  };
}

/** @param {{ value: string }} result */
export const isBit = (result) => !["commanded", "actual", "analog"].includes(result.value);

export class Picture {
  /** `on`: cursor(seconds or null), selected(from, to). `overlay()`: {marks, alarms, a, b} to be drawn over the curves.
   * @param {HTMLElement} plot @param {HTMLElement} lanes @param {PictureEvents} on @param {() => Overlay} overlay */
  constructor(plot, lanes, on, overlay) {
    this.elements = { plot, lanes };
    this.on = on;
    this.overlay = overlay;
    /** @type {Span} */
    this.range = [0, 1];
    this.shape = "";
    /** @type {uPlot | null} */
    this.curves = null;
    /** @type {uPlot | null} */
    this.lanes = null;
    new ResizeObserver(() => this.resize()).observe(plot);
  }

  /** New results over a span. `bound`: which scale each curve has, "shared" or "own"; `chosen`: whose axis is shown.
   * @param {Result[]} results @param {Span} range @param {string} bound @param {number} chosen */
  draw(results, range, bound, chosen) {
    const place = new Map(results.map((result, i) => [result, i]));
    const numbers = results.filter((result) => !isBit(result));
    const bits = results.filter(isBit);
    const shape = JSON.stringify([
      results.map((a) => [a.bus, a.unit, a.value, a.measure, a.name]),
      bound,
      chosen,
    ]);
    this.range = range;
    if (shape !== this.shape) this.build(numbers, bits, place, bound, chosen);
    this.shape = shape;
    /** @param {number} value @param {number} i */
    const lift = (value, i) => bits.length - 1 - i + value * LANE_FILL;
    this.curves?.setData(joined(numbers), false);
    this.lanes?.setData(joined(bits, lift), false);
    this.move(range);
  }

  /** Another span of the same data.
   * @param {Span} range */
  move(range) {
    this.range = range;
    const [min, max] = range;
    for (const plot of [this.curves, this.lanes]) plot?.setScale("x", { min, max });
  }

  redraw() {
    for (const plot of [this.curves, this.lanes]) plot?.redraw(false);
  }

  /** New colours, since the theme changed. */
  forget() {
    colours.clear();
    this.shape = "";
  }

  /** @param {Result[]} numbers @param {Result[]} bits @param {Map<Result, number>} place
   * @param {string} bound @param {number} chosen */
  build(numbers, bits, place, bound, chosen) {
    this.curves?.destroy();
    this.lanes?.destroy();
    /** @param {Result} result */
    const scaleOf = (result) =>
      bound === "own" ? `y${place.get(result)}` : result.value === "analog" ? "analog" : "speed";
    const shown = bound === "own" ? scaleOf(numbers[chosen] ?? numbers[0]) : null;
    const scales = [...new Set(numbers.map(scaleOf))];
    const gutter = bits.length && this.elements.plot.clientWidth > NARROW ? GUTTER_WIDE : GUTTER;
    const axes = scales.map((scale, i) => ({
      ...axis(),
      values: axisNumbers,
      scale,
      side: i ? 1 : 3,
      show: shown === null || shown === scale,
      size: (i ? GUTTER : gutter) - LABEL,
      labelSize: LABEL,
      label: numbers.find((result) => scaleOf(result) === scale)?.measure || " ",
      grid: { ...axis().grid, show: i === 0 || shown !== null },
    }));
    const right = axes.filter(({ side, show }) => show && side === 1).length * GUTTER;
    if (axes.length && shown !== null)
      for (const shownAxis of axes) Object.assign(shownAxis, { side: 3, size: gutter - LABEL });
    const margin = { left: axes.length ? 0 : gutter, right: PAD };
    this.curves = this.plot(this.elements.plot, numbers, place, scaleOf, axes, {
      margin,
      barefoot: bits.length > 0,
    });
    if (!bits.length) {
      this.lanes = null;
      return;
    }
    const laneAxis = {
      ...axis(),
      scale: "lane",
      side: 3,
      size: gutter,
      splits: () => bits.map((_, i) => i + LANE_FILL / 2),
      grid: { show: false },
      ticks: { show: false },
      values: () => bits.map((_, i) => shortened(bits[bits.length - 1 - i].name, gutter)),
    };
    const beside = { left: 0, right: PAD + (shown === null ? right : 0) };
    this.lanes = this.plot(this.elements.lanes, bits, place, () => "lane", [laneAxis], {
      margin: beside,
      lanes: bits.length,
    });
  }

  /** @param {HTMLElement} element @param {Result[]} results @param {Map<Result, number>} place
   * @param {(result: Result) => string} scaleOf @param {uPlot.Axis[]} axes
   * @param {PlotShape} shape @returns {uPlot} */
  plot(element, results, place, scaleOf, axes, { margin, barefoot = false, lanes = 0 }) {
    const stepped = uPlot.paths.stepped?.({ align: 1 });
    /** @type {uPlot.Series[]} */
    const series = [{}];
    /** @type {uPlot.Band[]} */
    const bands = [];
    for (const result of results) {
      const { name, dash } = look(place.get(result) ?? 0);
      const stroke = colour(name);
      const common = { scale: scaleOf(result), spanGaps: false, paths: lanes ? stepped : undefined };
      const edge = { ...common, stroke: INVISIBLE, width: 1, points: { show: false } };
      bands.push({ series: [series.length + 2, series.length + 1], fill: colour(name, BAND) });
      series.push(
        { ...common, stroke, dash, width: lanes ? 2 : 1.75, points: lanes ? { show: false } : { size: 4 } },
        edge,
        {
          ...edge,
        },
      );
    }
    /** @type {uPlot.Options} */
    const options = {
      width: element.clientWidth || 600,
      height: this.height(results.length, lanes),
      scales: {
        x: { time: true, auto: false, range: () => this.range },
        ...(lanes ? { lane: { range: () => [-0.2, lanes] } } : {}),
      },
      axes: [
        barefoot
          ? { ...axis(), values: (_, splits) => splits.map(() => ""), size: 0, ticks: { show: false } }
          : { ...axis(), values: axisLabels, space: 90, size: 44 },
        ...axes,
      ],
      padding: [12, margin.right, barefoot ? 8 : 0, margin.left],
      series,
      bands,
      legend: { show: false },
      cursor: {
        sync: { key: SYNC },
        y: false,
        points: { size: 7 },
        drag: { x: true, y: false, setScale: false },
      },
      hooks: {
        setCursor: [
          (plot) => this.on.cursor(cursorAt(plot)),
        ],
        setSelect: [(plot) => this.selected(plot)],
        draw: [(plot) => this.drawOverlay(plot)],
      },
      tzDate: (seconds) => uPlot.tzDate(new Date(seconds * 1000), zone),
    };
    return new uPlot(options, [[]], element);
  }

  /** @param {number} values @param {number} lanes */
  height(values, lanes) {
    if (lanes) return lanes * LANE + 54;
    if (!values) return LANE;
    return Math.max(MIN_HEIGHT, Math.min(560, Math.round(window.innerHeight * 0.5)));
  }

  resize() {
    const width = this.elements.plot.clientWidth;
    for (const plot of [this.curves, this.lanes])
      if (plot && width && plot.width !== width) plot.setSize({ width, height: plot.height });
  }

  /** @param {uPlot} plot */
  selected(plot) {
    const { left, width } = plot.select;
    if (width < 8) return;
    const [from, to] = [plot.posToVal(left, "x"), plot.posToVal(left + width, "x")];
    plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
    this.on.selected(from, to);
  }

  /** The time at a place of the screen, seconds.
   * @param {number} clientX */
  timeAt(clientX) {
    if (!this.curves) return (this.range[0] + this.range[1]) / 2;
    const box = this.curves.over.getBoundingClientRect();
    return this.curves.posToVal(clientX - box.left, "x");
  }

  /** Put the cursor on a time.
   * @param {number} at */
  point(at) {
    this.curves?.setCursor({ left: this.curves.valToPos(at, "x"), top: 10 });
  }

  /** @param {uPlot} plot */
  drawOverlay(plot) {
    const { marks, alarms, a, b } = this.overlay();
    const { ctx, bbox } = plot;
    /** @param {number | null} at @param {string} stroke @param {number[]} dash @param {string} label */
    const line = (at, stroke, dash, label) => {
      if (at === null || at < this.range[0] || at > this.range[1]) return;
      const x = Math.round(plot.valToPos(at, "x", true)) + 0.5;
      ctx.strokeStyle = ctx.fillStyle = stroke;
      ctx.setLineDash(dash);
      ctx.beginPath();
      ctx.moveTo(x, bbox.top);
      ctx.lineTo(x, bbox.top + bbox.height);
      ctx.stroke();
      if (label) ctx.fillText(label, x + 4 * devicePixelRatio, bbox.top + 12 * devicePixelRatio);
    };
    ctx.save();
    ctx.lineWidth = devicePixelRatio;
    ctx.textAlign = "left";
    ctx.font = `${12 * devicePixelRatio}px ${css("--family")}`;
    for (const mark of marks)
      line(mark.t, colour("--line-strong"), [2 * devicePixelRatio, 4 * devicePixelRatio], "");
    line(a, colour("--mark"), [], "A");
    line(b, colour("--mark"), [], "B");
    ctx.restore();
    if (plot === this.curves) drawAlarms(plot, alarms, this.range, colour);
  }
}

/** @param {string} name @param {number} width */
function shortened(name, width) {
  const most = Math.floor(width / LETTER) - 1;
  return name.length > most ? `${name.slice(0, most - 1)}…` : name;
}

/** The time at the cursor, null while it is not over the plot. @param {uPlot} plot */
function cursorAt(plot) {
  const { left = -1 } = plot.cursor;
  return left >= 0 ? plot.posToVal(left, "x") : null;
}

/** @returns {uPlot.Axis} */
function axis() {
  const ink = colour("--quiet");
  return {
    stroke: ink,
    font: `12px ${css("--family")}`,
    grid: { stroke: colour("--line"), width: 1 },
    ticks: { stroke: colour("--line"), width: 1 },
  };
}
