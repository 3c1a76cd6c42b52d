// The picture: curves with their bands above, bits as lanes below, one time axis for both.
import { zone } from "./clock.js";
import { joined, lastValue } from "./trends-data.js";
import { drawLabels } from "./trends-labels.js";
import { colour, css, DIMMED, forgetColors, isBit, look, PAST } from "./trends-look.js";
import { lanesHeight, overlayPlugin } from "./trends-overlay.js";
import { axisLabels, axisNumbers } from "./trends-time.js";

const LANE = 30;
const LANE_FILL = 0.7;
/** Below the lanes: their time axis. */
const FOOT = 60;
const MIN_HEIGHT = 160;
/** Widths left of the curves, so that the lanes below stand under them, and right of them for their names. */
const GUTTER = 84;
const GUTTER_WIDE = 168;
const GUTTER_NARROW = 52;
const NAMES = 132;
const NAMES_NARROW = 24;
const LABEL = 20;
const NARROW = 700;
/** How much of a curve's color its band has, percent. */
const BAND = 20;
const LETTER = 8;
const SYNC = "trends";
const INVISIBLE = "rgb(0 0 0 / 0)";

export class Picture {
  /** `on`: cursor(seconds or null), selected(from, to). `overlay()`: what is drawn over the curves.
   * @param {HTMLElement} plot @param {HTMLElement} lanes @param {PictureEvents} on @param {() => Overlay} overlay
   * @param {LaneWords} words */
  constructor(plot, lanes, on, overlay, words) {
    this.elements = { plot, lanes };
    this.on = on;
    this.overlay = overlay;
    this.words = words;
    /** @type {Span} */
    this.range = [0, 1];
    /** @type {Span[]} */
    this.unknown = [];
    this.shape = "";
    this.above = 0;
    /** @type {Curve[]} */
    this.numbers = [];
    /** The curves of each plot, three series each. @type {Curve[][]} */
    this.drawn = [];
    /** @type {uPlot | null} */
    this.curves = null;
    /** @type {uPlot | null} */
    this.lanes = null;
    new ResizeObserver(() => this.resize()).observe(plot);
  }

  /** New results over a span. `bound`: which scale each curve has, "shared" or "own"; `chosen`: whose axis is shown;
   * `unknown`: where nothing was read.
   * @param {Curve[]} results @param {Span} range @param {Span[]} unknown @param {string} bound @param {number} chosen */
  draw(results, range, unknown, bound, chosen) {
    this.numbers = results.filter((result) => !isBit(result));
    const bits = results.filter((result) => isBit(result) && !result.past);
    const shape = JSON.stringify([
      results.map((a) => [a.bus, a.unit, a.value, a.measure, a.name, a.past]),
      bound,
      chosen,
      this.isNarrow(),
    ]);
    this.range = range;
    this.unknown = unknown;
    if (shape !== this.shape) this.build(bits, bound, chosen);
    this.shape = shape;
    /** @param {number} value @param {number} i */
    const lift = (value, i) => bits.length - 1 - i + value * LANE_FILL;
    this.drawn = [this.numbers, bits];
    this.dim();
    this.curves?.setData(joined(this.numbers), false);
    this.lanes?.setData(joined(bits, lift), false);
    this.move(range);
  }

  /** Dim the lines of the curves that are to be dimmed. */
  dim() {
    [this.curves, this.lanes].forEach((plot, which) => {
      plot?.series.forEach((series, i) => {
        if (i) series.alpha = this.drawn[which][Math.floor((i - 1) / 3)]?.dimmed ? DIMMED : 1;
      });
    });
  }

  isNarrow() {
    return this.elements.plot.clientWidth <= NARROW;
  }

  /** Another span of the same data.
   * @param {Span} range */
  move(range) {
    this.range = range;
    const [min, max] = range;
    for (const plot of [this.curves, this.lanes]) plot?.setScale("x", { min, max });
  }

  /** The overlay has changed; the lanes above them may have more rows. */
  redraw() {
    if (this.above !== lanesHeight(this.overlay(), this.range)) this.resize();
    for (const plot of [this.curves, this.lanes]) plot?.redraw(false);
  }

  /** New colors, since the theme changed. */
  forget() {
    forgetColors();
    this.shape = "";
  }

  /** @param {Curve[]} bits @param {string} bound @param {number} chosen */
  build(bits, bound, chosen) {
    const { numbers } = this;
    this.curves?.destroy();
    this.lanes?.destroy();
    /** @param {Curve} result */
    const scaleOf = ({ value, place }) =>
      bound === "own" ? `y${place}` : value === "analog" || value === "draw" ? value : "speed";
    const shown = bound === "own" ? scaleOf(numbers.find(({ place }) => place === chosen) ?? numbers[0] ?? {}) : null;
    const scales = [...new Set(numbers.map(scaleOf))].filter((scale) => shown === null || scale === shown);
    const narrow = this.isNarrow();
    const gutter = narrow ? GUTTER_NARROW : bits.length ? GUTTER_WIDE : GUTTER;
    const axes = scales.map((scale, i) => ({
      ...axis(),
      values: axisNumbers,
      scale,
      side: 3,
      size: (i ? GUTTER_NARROW : gutter) - (narrow ? 0 : LABEL),
      labelSize: narrow ? 0 : LABEL,
      label: (!narrow && numbers.find((result) => scaleOf(result) === scale)?.measure) || " ",
      grid: { ...axis().grid, show: i === 0 },
    }));
    const left = gutter + Math.max(0, axes.length - 1) * GUTTER_NARROW;
    const right = numbers.length ? (narrow ? NAMES_NARROW : NAMES) : NAMES_NARROW;
    this.elements.plot.classList.toggle("trends__plot--none", !numbers.length);
    const margin = { left: axes.length ? 0 : left, right };
    this.curves = this.plot(this.elements.plot, numbers, scaleOf, axes, { margin, barefoot: bits.length > 0 });
    if (!bits.length) {
      this.lanes = null;
      return;
    }
    const laneAxis = {
      ...axis(),
      scale: "lane",
      side: 3,
      size: left,
      splits: () => bits.map((_, i) => i + LANE_FILL / 2),
      grid: { show: false },
      ticks: { show: false },
      values: () =>
        bits.map((_, i) => {
          const { place, name } = bits[bits.length - 1 - i];
          return shortened(`${place + 1} ${name}`, left);
        }),
    };
    const beside = { left: 0, right };
    this.lanes = this.plot(this.elements.lanes, bits, () => "lane", [laneAxis], { margin: beside, lanes: bits.length });
  }

  /** @param {HTMLElement} element @param {Curve[]} results @param {(result: Curve) => string} scaleOf
   * @param {uPlot.Axis[]} axes @param {PlotShape} shape @returns {uPlot} */
  plot(element, results, scaleOf, axes, { margin, barefoot = false, lanes = 0 }) {
    /** @type {uPlot.Series[]} */
    const series = [{}];
    /** @type {uPlot.Band[]} */
    const bands = [];
    for (const result of results) {
      if (!result.past)
        bands.push({
          series: [series.length + 2, series.length + 1],
          fill: colour(look(result.place).name, BAND),
        });
      series.push(...strokes(result, scaleOf(result), lanes > 0));
    }
    const range = () => this.range;
    const shown = () => ({ overlay: this.overlay(), span: this.range, unknown: results.length ? this.unknown : [] });
    const above = () => {
      this.above = lanesHeight(this.overlay(), this.range);
      return this.above;
    };
    /** @type {uPlot.Options} */
    const options = {
      width: element.clientWidth || 600,
      height: this.height(lanes),
      scales: {
        x: { time: true, auto: false, range },
        ...(lanes ? { lane: { range: () => [-0.2, lanes] } } : {}),
      },
      axes: [
        barefoot
          ? { ...axis(), values: (_, splits) => splits.map(() => ""), size: 0, ticks: { show: false } }
          : { ...axis(), values: axisLabels, space: 100, size: 50 },
        ...axes,
      ],
      padding: [lanes ? 12 : above, margin.right, barefoot ? 8 : 0, margin.left],
      series,
      bands,
      legend: { show: false },
      cursor: {
        sync: { key: SYNC },
        y: false,
        points: { size: 7 },
        // A press with Shift selects; any other pulls the picture (trends-gestures.js), and its click is no end of a drag.
        bind: { mousedown: (_plot, _target, select) => (event) => (event.shiftKey ? select(event) : unscrolled(event)) },
        drag: { x: true, y: false, setScale: false, click: () => {} },
      },
      hooks: {
        setCursor: [(plot) => this.on.cursor(cursorAt(plot))],
        setSelect: [(plot) => this.selected(plot)],
        draw: [(plot) => !lanes && drawLabels(plot, this.ends(scaleOf), margin.right)],
      },
      plugins: [overlayPlugin(shown, lanes ? null : this.words)],
      tzDate: (seconds) => uPlot.tzDate(new Date(seconds * 1000), zone),
    };
    return new uPlot(options, [[]], element);
  }

  /** @param {(result: Curve) => string} scaleOf @returns {LineEnd[]} */
  ends(scaleOf) {
    return this.numbers.flatMap((result) => {
      const value = result.past ? null : lastValue(result, this.range);
      return value === null ? [] : [{ ...result, value, scale: scaleOf(result) }];
    });
  }

  /** @param {number} lanes */
  height(lanes) {
    if (lanes) return lanes * LANE + FOOT;
    if (!this.numbers.length) return LANE + lanesHeight(this.overlay(), this.range);
    return Math.max(MIN_HEIGHT, this.elements.plot.clientHeight);
  }

  resize() {
    const width = this.elements.plot.clientWidth;
    if (!width || !this.curves) return;
    this.curves.setSize({ width, height: this.height(0) });
    if (this.lanes && this.lanes.width !== width) this.lanes.setSize({ width, height: this.lanes.height });
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
}

/** The line of a result, and the edges of its band.
 * @param {Curve} result @param {string} scale @param {boolean} isLane @returns {uPlot.Series[]} */
function strokes({ place, value, past }, scale, isLane) {
  const { name, dash } = look(place, value);
  const paths = isLane ? uPlot.paths.stepped?.({ align: 1 }) : undefined;
  const common = { scale, spanGaps: false, paths };
  const edge = { ...common, stroke: INVISIBLE, width: 1, points: { show: false } };
  const line = past
    ? { stroke: colour(name, PAST.percent), dash: PAST.dash, width: PAST.width, points: { show: false } }
    : {
        stroke: colour(name),
        dash: isLane ? [] : dash,
        width: 2,
        points: isLane ? { show: false } : { size: 5, show: true, filter: dots },
      };
  return [{ ...common, ...line }, edge, { ...edge }];
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

/** @param {string} name @param {number} width */
function shortened(name, width) {
  const most = Math.floor(width / LETTER) - 1;
  return name.length > most ? `${name.slice(0, most - 1)}…` : name;
}

/** The middle button pulls as the left one does, and scrolls no page. @param {MouseEvent} event */
function unscrolled(event) {
  if (event.button === 1) event.preventDefault();
  return null;
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
    font: `14px ${css("--family")}`,
    grid: { stroke: colour("--line"), width: 1 },
    ticks: { stroke: colour("--line"), width: 1 },
  };
}
