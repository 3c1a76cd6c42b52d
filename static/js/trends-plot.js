// The picture: curves with their bands, below them bits as lanes, one time axis for both.
import { zone } from "./clock.js";
import { joined } from "./trends-data.js";
import { LANE_FILL, lanesHeight, overlayPlugin } from "./trends-overlay.js";
import { axisLabels, axisNumbers } from "./trends-time.js";
import { isBit, look } from "./trends-values.js";

/** Heights of a lane, of what is below the lowest of them, of the time axis, and the least that curves have. */
const [LANE, LANES_END, FOOT, LEAST] = [30, 6, 50, 110];
/** Widths left of the chart: for numbers, for names of lanes, on a phone; right of it for names of lines; of a unit. */
const [GUTTER, GUTTER_WIDE, GUTTER_NARROW, NAMES, NAMES_NARROW, LABEL] = [92, 168, 52, 168, 34, 20];
/** Up to this width it is on a phone. */
const NARROW = 700;
/** How much of a curve's color its band has, percent, and how much is left of a dimmed line. */
const [BAND, DIMMED] = [20, 0.18];
/** A line of an earlier time is narrow, dotted and lighter. */
const PAST = { dash: [1, 3], width: 1.5, percent: 70 };
const INVISIBLE = "rgb(0 0 0 / 0)";
/** A scale is no narrower than this part of its highest value, and than ten steps of what a unit displays: the usual unrest of a
 * speed is no movement. */
const [LEAST_PART, LEAST_STEPS] = [0.04, 10];
/** By how many at-speed windows average, least and greatest of a commanded speed are moved: its band is where a unit is at speed. */
const AROUND = [0, -1, 1];
/** The least width of a span that is selected, in pixels. */
const SELECTED = 8;

export class Picture {
  /** `on`: cursor(seconds or null), selected(from, to).
   * @param {HTMLElement} element @param {Trends} trends @param {PictureEvents} on */
  constructor(element, trends, on) {
    this.element = element;
    this.trends = trends;
    this.on = on;
    this.shape = "";
    /** Three series each: average, least and greatest. @type {Curve[]} */
    this.lines = [];
    /** @type {Curve[]} */
    this.bits = [];
    /** The lowest number of each scale that is above the lanes. @type {Record<string, number>} */
    this.floors = {};
    /** Pixels left and right of the chart. */
    this.beside = 0;
    /** @type {uPlot | null} */
    this.plot = null;
    new ResizeObserver(() => this.resize()).observe(element);
  }

  /** Draw what is shown now. */
  draw() {
    const { curves, past, view, chosen, dimmed } = this.trends;
    this.lines = [...past, ...curves];
    this.bits = curves.filter(isBit);
    const isNarrow = this.element.clientWidth <= NARROW;
    const lines = this.lines.map(({ key, measure, name, past }) => [key, measure, name, past]);
    const shape = JSON.stringify([lines, view.scale, chosen, isNarrow]);
    if (shape !== this.shape) this.build(isNarrow);
    this.shape = shape;
    this.plot?.series.forEach((series, i) => {
      if (i) series.alpha = dimmed.has(this.lines[Math.floor((i - 1) / 3)].key) ? DIMMED : 1;
    });
    const windows = this.lines.map((line) => (line.past ? 0 : this.trends.catalogue.window(line)));
    /** @param {number} value @param {number} i @param {number} column */
    const lifted = (value, i, column) => {
      const lane = this.bits.indexOf(this.lines[i]);
      return lane < 0 ? value + AROUND[column] * windows[i] : this.bits.length - 1 - lane + value * LANE_FILL;
    };
    this.plot?.setData(joined(this.lines, lifted), false);
    this.move();
    this.resize();
  }

  /** The span has changed, of the same data. */
  move() {
    const [min, max] = this.trends.range;
    this.plot?.setScale("x", { min, max });
  }

  /** The colors have changed with the theme. */
  recolour() {
    this.shape = "";
    this.draw();
  }

  /** @param {boolean} isNarrow */
  build(isNarrow) {
    const { element, lines, bits, trends } = this;
    this.plot?.destroy();
    const numbers = lines.filter((line) => !isBit(line));
    const isOwn = trends.view.scale === "own";
    /** @param {Curve} line */
    const scaleOf = (line) => {
      if (isBit(line)) return "lane";
      return isOwn ? line.key : line.value === "analog" || line.value === "draw" ? line.value : "speed";
    };
    const scales = [...new Set(numbers.map(scaleOf))];
    const shown = isOwn ? scales.slice(Math.max(0, scales.indexOf(trends.chosen))).slice(0, 1) : scales;
    const gutter = isNarrow ? GUTTER_NARROW : bits.length ? GUTTER_WIDE : GUTTER;
    const room = isNarrow || !numbers.length ? NAMES_NARROW : NAMES;
    const [line, font] = [{ stroke: colour("--line"), width: 1 }, `14px ${getComputedStyle(element).fontFamily}`];
    const axis = { stroke: colour("--quiet"), font, grid: line, ticks: line };
    const axes = shown.map((scale, i) => ({
      ...axis,
      scale,
      side: 3,
      size: isNarrow ? GUTTER_NARROW : (i ? GUTTER : gutter) - LABEL,
      labelSize: isNarrow ? 0 : LABEL,
      label: (!isNarrow && numbers.find((line) => scaleOf(line) === scale)?.measure) || " ",
      grid: { ...line, show: i === 0 },
      values: axisNumbers,
      splits: this.splits(scale),
    }));
    element.classList.toggle("trends__plot--none", !numbers.length);
    this.beside = gutter + (isNarrow ? GUTTER_NARROW : GUTTER) * Math.max(0, axes.length - 1) + room;
    trends.room = { chart: (element.clientWidth || 600) - this.beside, beside: room };
    /** @type {uPlot.Options} */
    const options = {
      width: element.clientWidth || 600,
      height: this.height(),
      scales: {
        x: { time: true, auto: false, range: () => trends.range },
        lane: { range: () => [-LANES_END / LANE, (this.chartHeight() - LANES_END) / LANE] },
        ...Object.fromEntries(scales.map((scale) => [scale, { range: this.aboveLanes.bind(this) }])),
      },
      axes: [{ ...axis, values: axisLabels, space: 100, size: FOOT }, ...axes],
      // Without a value in sight there are no numbers left of the chart, but the first time below it and the name of the lanes.
      padding: [() => lanesHeight(trends), room, 0, ({ scales: of }) => (shown.some((scale) => of[scale].min != null) ? 0 : gutter)],
      series: [{}, ...lines.flatMap((line) => strokes(line, scaleOf(line)))],
      bands: lines.flatMap(({ place, past }, i) =>
        past ? [] : [{ series: [3 * i + 3, 3 * i + 2], fill: colour(look(place).name, BAND) }],
      ),
      legend: { show: false },
      cursor: {
        y: false,
        points: { size: 7 },
        // A press with Shift selects; any other pulls the picture (trends-controls.js), and its click is no end of a drag.
        bind: { mousedown: (_plot, _target, select) => (event) => (event.shiftKey ? select(event) : null) },
        drag: { x: true, y: false, setScale: false, click: () => {} },
      },
      hooks: {
        setCursor: [(plot) => this.on.cursor((plot.cursor.left ?? -1) < 0 ? null : plot.posToVal(plot.cursor.left ?? 0, "x"))],
        setSelect: [(plot) => this.selected(plot)],
      },
      plugins: [overlayPlugin(trends, scaleOf, room)],
      tzDate: (seconds) => uPlot.tzDate(new Date(seconds * 1000), zone),
    };
    this.plot = new uPlot(options, [[]], element);
  }

  /** Where a scale has lines: as uPlot would, but none in the lanes. @param {string} scale @returns {uPlot.Axis.Splits} */
  splits(scale) {
    return (_plot, _axis, _least, most, step) => {
      const first = Math.ceil(this.floors[scale] / step);
      return Array.from({ length: Math.floor(most / step + 1e-9) - first + 1 }, (_, i) => (first + i) * step);
    };
  }

  /** The range of a scale as uPlot would choose it, but never so narrow that noise looks like movement, and below it room for the lanes.
   * @param {uPlot} _plot @param {number | null} least @param {number | null} most @param {string} scale @returns {uPlot.Range.MinMax} */
  aboveLanes(_plot, least, most, scale) {
    if (least === null || most === null) return [null, null];
    const steps = this.lines.filter((line) => !isBit(line)).map(({ decimals }) => LEAST_STEPS * 10 ** -(decimals ?? 0));
    const pad = Math.max(0, Math.max(LEAST_PART * Math.abs(most), Math.min(...steps)) - (most - least)) / 2;
    const [low, high] = /** @type {[number, number]} */ (uPlot.rangeNum(least - pad, most + pad, 0.1, true));
    this.floors[scale] = low;
    const lanes = this.lanesBelow();
    return [low - ((high - low) * lanes) / (this.chartHeight() - lanes), high];
  }

  lanesBelow() {
    return this.bits.length ? this.bits.length * LANE + LANES_END : 0;
  }

  chartHeight() {
    return this.height() - lanesHeight(this.trends) - FOOT;
  }

  height() {
    const around = lanesHeight(this.trends) + this.lanesBelow() + FOOT;
    const hasCurves = this.lines.length > this.bits.length;
    return hasCurves ? Math.max(around + LEAST, this.element.clientHeight) : around + (this.bits.length ? 0 : LANE);
  }

  /** Take the room that there is, and draw again what lies over and above the curves: its lanes may have more rows. */
  resize() {
    const width = this.element.clientWidth;
    if (!width) return;
    this.trends.room.chart = width - this.beside;
    this.plot?.setSize({ width, height: this.height() });
  }

  /** @param {uPlot} plot */
  selected(plot) {
    const { left, width } = plot.select;
    if (width < SELECTED) return;
    const [from, to] = [left, left + width].map((at) => plot.posToVal(at, "x"));
    plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
    this.on.selected(from, to);
  }

  /** The time at a place of the screen, seconds. @param {number} clientX */
  timeAt(clientX) {
    const [from, to] = this.trends.range;
    return this.plot?.posToVal(clientX - this.plot.over.getBoundingClientRect().left, "x") ?? (from + to) / 2;
  }

  /** Put the cursor on a time. @param {number} at */
  point(at) {
    this.plot?.setCursor({ left: this.plot.valToPos(at, "x"), top: 10 });
  }
}

/** The line of a result, and the edges of its band. @param {Curve} line @param {string} scale @returns {uPlot.Series[]} */
function strokes({ place, value, past }, scale) {
  const { name, dash } = look(place, value);
  const isLane = scale === "lane";
  const paths = isLane ? uPlot.paths.stepped?.({ align: 1 }) : undefined;
  const common = { scale, spanGaps: false, paths, width: 2, stroke: INVISIBLE, points: { show: false } };
  const points = isLane || past ? common.points : { size: 5, show: true, filter: dots };
  const drawn = past ? { ...PAST, stroke: colour(name, PAST.percent) } : { stroke: colour(name), dash: isLane ? [] : dash };
  return [{ ...common, points, ...drawn }, { ...common }, { ...common }];
}

/** @type {uPlot.Series.Points.Filter} */
const dots = (plot, series) => alone(plot.data[series]);

/** The places of values with a hole on either side: no line shows them. Dots elsewhere would fill the dashes.
 * @param {ArrayLike<number | null | undefined>} column */
export function alone(column) {
  const known = Array.from(column, (value, place) => ({ value, place })).filter(({ value }) => value !== undefined);
  /** @param {number} i */
  const isHole = (i) => (known[i]?.value ?? null) === null;
  return known.filter((_, i) => !isHole(i) && isHole(i - 1) && isHole(i + 1)).map(({ place }) => place);
}

/** A color that light-dark() gives, as the canvas understands it; `percent` of it, the rest shines through.
 * @param {string} name */
function colour(name, percent = 100) {
  const probe = document.body.appendChild(document.createElement("i"));
  probe.style.color = `color-mix(in srgb, var(${name}) ${percent}%, transparent)`;
  const found = getComputedStyle(probe).color;
  probe.remove();
  return found;
}
