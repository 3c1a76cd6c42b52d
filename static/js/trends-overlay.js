// What lies over and around the curves, as elements over the canvas: the lanes of alarms and notes, the events, the cursors A
// and B, hatching where nothing was read, and the names of the lines. Places are percent of the span.
import { now } from "./clock.js";
import { endValue, lastValue } from "./trends-data.js";
import { drawing, isBit } from "./trends-values.js";

/** Height of a row of the lanes, and what is below them. */
const [ROW, GAP] = [24, 6];
/** Height of the name of a line, the length of the hair that leads to it, and the room that a name needs. */
const [NAME, HAIR, LEAST_NAME] = [17, 12, 53];
/** How much of the height of its lane a bit takes. */
export const LANE_FILL = 0.7;
const PRIORITIES = ["urgent", "high", "medium", "low"];
/** More alarms of one priority at a time share its last row, and all have no more rows than leave the curves of a phone their height. */
const ROWS_OF_PRIORITY = 2;
/** @param {number} chart */
const mostRows = (chart) => (chart < 400 ? 4 : 8);
/** Pixels of a letter of the names of alarms, of what keeps them off a mark, how many letters of a place are enough where there is no
 * room for all, and of all in a row that would have no name. */
const [LETTER, OFF, LEAST_LETTERS, LEAST_OF_ALL] = [7, 15, 2, 14];
/** Which of the places of a name is on the line of its alarm. */
const ON_LINE = 2;
/** Percent from one mark of a row to the next that is drawn: nearer ones would hide each other. */
const LEAST_APART = 3;

/** Where a time is in a span, in percent; what is outside is at its end. @param {Span} span */
const percentIn = ([from, to]) => /** @param {number} t */ (t) => (100 * (Math.min(Math.max(t, from), to) - from)) / (to - from);

/** @param {Span} one @param {Span} other */
const meet = (one, other) => one[0] < other[1] && other[0] < one[1];

/** Where each alarm of a span begins and ends, and whose it is: `row` counts from the top, the most important priority first, and
 * a second row of a priority has what has no room in the first. `named` is where its name stands, after its line, before it or on
 * it, and over no other; null where only its mark has room, whose name is in the list. An active alarm has room before a cleared
 * one and a later before an earlier one, and the same alarm again has that of its former name. That of a lower row is drawn over
 * the area of a finger of the one above.
 * @param {Alarm[]} alarms @param {Span} span @param {{ chart: number, beside: number }} room in pixels @returns {PlacedAlarm[]} */
export function placed(alarms, [from, to], { chart, beside }) {
  const percent = percentIn([from, to]);
  const right = 100 + (100 * Math.max(0, beside - OFF / 3)) / chart;
  /** @param {number} letters @param {number} marks beside it */
  const width = (letters, marks) => (100 * (letters * LETTER + marks * OFF)) / chart;
  /** Where a name of one of these lengths has room, whatever else is there.
   * @param {{ x: number, end: number }} mark @param {number[]} lengths */
  const namesOf = ({ x, end }, lengths) =>
    lengths
      .flatMap((letters) => /** @type {Span[]} */ ([[end, end + width(letters, 2)], [x - width(letters, 1), x], [x, x + width(letters, 2)]]))
      .filter(([a, b], place) => a >= 0 && b <= (place % 3 === ON_LINE ? end : right));
  const shown = alarms.map((alarm, index) => ({ ...alarm, index })).filter(({ t, until }) => t < to && (until ?? to) > from);
  let first = 0;
  let spare = mostRows(chart) - new Set(shown.map(({ priority }) => priority)).size;
  return PRIORITIES.flatMap((priority) => {
    /** @type {PlacedAlarm[][]} */
    const rows = [];
    const most = Math.min(ROWS_OF_PRIORITY, 1 + spare);
    const of = shown
      .filter((alarm) => alarm.priority === priority)
      .sort((one, other) => Number(one.until !== null) - Number(other.until !== null) || one.t - other.t);
    for (const alarm of of) {
      const label = [alarm.place, alarm.name].filter(Boolean).join(" · ");
      const [x, end] = [percent(alarm.t), percent(alarm.until ?? to)];
      const least = label.length - Math.max(0, label.lastIndexOf(" · ") - LEAST_LETTERS);
      const names = namesOf({ x, end }, [label.length, least]);
      const numbers = [...rows.keys(), rows.length].slice(0, most);
      const spots = numbers.flatMap((number) => names.map((name) => ({ number, name })));
      /** @param {number} number @param {Span} span @param {boolean} overNames */
      const isFree = (number, span, overNames) =>
        (rows[number] ?? []).every((other) => {
          const keeps = !overNames || other.until === null;
          const isInName = keeps && other.named !== null && other.label !== label && meet(span, other.named);
          return !isInName && !meet(span, [other.x, other.end]);
        });
      /** @param {boolean} overNames */
      const find = (overNames) =>
        spots.find(({ number, name }) => isFree(number, [x, end], overNames) && isFree(number, name, overNames));
      const unnamed = numbers.find((number) => isFree(number, [x, end], true)) ?? numbers.length - 1;
      const { number, name } = find(false) ?? find(true) ?? { number: unnamed, name: null };
      const row = rows[number] ?? [];
      rows[number] = row;
      for (const other of row) {
        if (other.named && (meet(other.named, [x, end]) || (name && meet(other.named, name)))) other.named = null;
      }
      row.push({ ...alarm, row: first + number, x, end, label, named: name });
    }
    // A mark that has given its room to a later one may have other room; a row without any name has one that is cut.
    for (const mark of rows.flat()) {
      const row = rows[mark.row - first] ?? [];
      if (row.some(({ named, label }) => named && label === mark.label)) continue;
      const others = row.filter((other) => other !== mark).flatMap(({ x, end, named }) => /** @type {Span[]} */ ([[x, end], ...(named ? [named] : [])]));
      const cut = row.some(({ named }) => named) ? [] : [LEAST_OF_ALL];
      mark.named ??= namesOf(mark, [mark.label.length, ...cut]).find((name) => !others.some((other) => meet(name, other))) ?? null;
    }
    for (const row of rows) for (const mark of row) if (mark.named) mark.named = grown(mark, row, width(mark.label.length + 2, 2), right);
    first += rows.length;
    spare -= Math.max(0, rows.length - 1);
    return rows.flat();
  }).sort((a, b) => a.row - b.row || a.x - b.x);
}

/** The room of a name up to what it needs whole or to what is next in its row.
 * @param {PlacedAlarm} mark @param {PlacedAlarm[]} row @param {number} whole @param {number} right @returns {Span} */
function grown({ x, end, named }, row, whole, right) {
  const [a, b] = /** @type {Span} */ (named);
  const others = row.filter((other) => other.named !== named).flatMap((other) => [[other.x, other.end], ...(other.named ? [other.named] : [])]);
  if (a < x) return [Math.max(b - whole, 0, ...others.map(([, last]) => last).filter((last) => last <= a)), b];
  if (a === x && a < end) return [a, Math.min(a + whole, end)];
  return [end, Math.min(a + whole, right, ...others.map(([start]) => start).filter((start) => start >= b))];
}

/** How many rows the alarms of a span take; at least one, so that the chart does not move with the first.
 * @param {Alarm[]} alarms @param {Span} span @param {{ chart: number, beside: number }} room */
export const alarmRows = (alarms, span, room) => Math.max(1, ...placed(alarms, span, room).map(({ row }) => row + 1));

/** What happened, as far as the view shows it. @param {Trends} trends */
const happened = ({ view, marks, alarms, notes }) => (view.marks ? { marks, alarms, notes } : { marks: [], alarms: [], notes: [] });

/** Height of the lanes above the curves, in pixels. @param {Trends} trends */
export function lanesHeight(trends) {
  const { alarms, notes } = happened(trends);
  return (alarmRows(alarms, trends.range, trends.room) + (notes.length ? 1 : 0)) * ROW + GAP;
}

/** A plugin of uPlot that draws it with the curves. `scaleOf` gives the scale of a curve, `room` are the pixels right of the
 * chart. @param {Trends} trends @param {(curve: Curve) => string} scaleOf @param {number} room @returns {uPlot.Plugin} */
export function overlayPlugin(trends, scaleOf, room) {
  const layer = document.createElement("div");
  layer.className = "trends__over";
  layer.ariaHidden = "true";
  return {
    hooks: {
      ready: (plot) => plot.over.after(layer),
      draw: (plot) => {
        layer.style.cssText = plot.over.style.cssText;
        layer.replaceChildren(...lines(trends), ...lanes(trends), ...names(plot, trends, scaleOf, room));
      },
    },
  };
}

/** @param {string} className @param {Record<string, number | string>} place @param {...(string | Node)} content */
function part(className, place, ...content) {
  const element = document.createElement("span");
  element.className = className;
  element.append(...content);
  for (const [name, value] of Object.entries(place)) element.style.setProperty(name, typeof value === "number" ? `${value}%` : value);
  return element;
}

/** What is as high as the chart. @param {Trends} trends */
function lines(trends) {
  const { range: [from, to], unknown, words, view: { a, b } } = trends;
  const { marks, notes } = happened(trends);
  const left = percentIn([from, to]);
  /** @param {Span} of */
  const between = ([begun, end]) => ({ left: left(begun), width: left(end) - left(begun) });
  /** @param {number | null} t @param {string} kind */
  const line = (t, kind, text = "") =>
    t === null || t < from || t > to ? [] : [part(`trends__line trends__line--${kind}`, { left: left(t) }, text)];
  // Names of spans that are near to each other would lie over each other.
  const named = marks.findLast(({ t, until }) => until !== null && until >= from && t <= to);
  return [
    ...unknown.map((span) => part("trends__unknown", between(span))),
    ...marks.flatMap((mark) => {
      const { t, until } = mark;
      if (until === null) return line(t, "event");
      const direction = left(t) > 50 ? "rtl" : "ltr";
      return until < from || t > to ? [] : [part("trends__late", { ...between([t, until]), direction }, mark === named ? words.late : "")];
    }),
    ...notes.flatMap(({ t }) => line(t, "note")),
    ...line(a, "cursor", "A"),
    ...line(b, "cursor", "B"),
  ];
}

/** What is above the chart: one or two rows for each priority of alarms, and one of notes. @param {Trends} trends */
function lanes(trends) {
  const { range, room, words } = trends;
  const { alarms, notes } = happened(trends);
  const [rows, left] = [alarmRows(alarms, range, room), percentIn(range)];
  /** @param {number} row */
  const top = (row) => `${row * ROW - lanesHeight(trends)}px`;
  /** @param {string} word @param {number} row @param {number} count */
  const lane = (word, row, count) => part("trends__lane", { top: top(row), height: `${count * ROW}px` }, part("", {}, word));
  let drawn = { row: -1, x: 0 };
  return [
    lane(words.alarms, 0, rows),
    ...(notes.length ? [lane(words.notes, rows, 1)] : []),
    ...placed(alarms, range, room).flatMap(({ index, priority, until, row, x, end, label, named }) => {
      const mark = part("trends__alarm alarm-priority", { left: x, top: top(row), width: end - x });
      Object.assign(mark.dataset, { is: until === null ? priority : `${priority} cleared`, list: "alarms", index });
      if (until === null || row !== drawn.row || x - drawn.x >= LEAST_APART) {
        mark.append(part("alarm-priority__shape", {}));
        drawn = { row, x };
      }
      if (!named) return [mark];
      const [side, at] = named[0] < x ? ["right", 100 - x] : ["left", named[0]];
      const who = part("trends__who", { [side]: at, top: top(row), "max-width": named[1] - named[0], [`padding-${side}`]: `${OFF}px` }, ...givingWay(label));
      return named[0] === x && x < end ? [mark, who] : [who, mark];
    }),
    ...notes.flatMap(({ t }, index) => {
      const flag = part("trends__flag", { left: left(t), top: top(rows) }, part("", {}, String(index + 1)));
      Object.assign(flag.dataset, { list: "notes", index });
      return t < range[0] || t > range[1] ? [] : [flag];
    }),
  ];
}

/** The names of curves right of the chart, each tied to the height at which its curve ends by a hair, which is no part of the
 * curve, and quiet without one where the curve ends before or its unit is silent; and those of bits left of their lanes.
 * @param {uPlot} plot @param {Trends} trends @param {(curve: Curve) => string} scaleOf @param {number} room */
function names(plot, { curves, range, dimmed, silent }, scaleOf, room) {
  const ends = curves.flatMap((curve) => {
    const value = isBit(curve) ? null : lastValue(curve, range);
    const ended = silent.has(curve.key) || endValue(curve, range, now()) === null;
    return value === null ? [] : [{ ...curve, ended, wanted: plot.valToPos(value, scaleOf(curve)) }];
  });
  const places = apart(ends.map(({ wanted }) => wanted), NAME, [NAME / 2, plot.over.clientHeight]);
  const hairs = ends.map(({ wanted, ended }, i) => (ended ? "" : `M0 ${wanted}L${HAIR} ${places[i]}`));
  return [
    drawing("trends__hairs", hairs.join("")),
    ...ends.map(({ unit, label, key, ended }, i) => {
      const name = part("trends__name", { top: `${places[i]}px`, "max-width": `${room - HAIR - 4}px` }, `${unit}`);
      if (room > LEAST_NAME) name.append(...givingWay(label));
      name.classList.toggle("trends__name--dimmed", ended || dimmed.has(key));
      return name;
    }),
    ...curves.filter(isBit).map(({ unit, name }, i, { length }) => {
      const middle = plot.valToPos(length - 1 - i + LANE_FILL / 2, "lane");
      return part("trends__bit", { top: `${middle}px`, "max-width": `${plot.over.offsetLeft - 8}px` }, `${unit} ${name}`);
    }),
  ];
}

/** The name of a unit, which is cut where it is too long, and what is shown of it or happens there, which is cut last.
 * @param {string} label */
function givingWay(label) {
  const at = label.lastIndexOf(" · ");
  const unit = document.createElement("bdi");
  unit.textContent = at < 0 ? label : label.slice(0, at);
  return at < 0 ? [unit] : [unit, part("", {}, label.slice(at))];
}

/** Where labels of a height stand that want to be at `wanted`, in order of these, within a span: midway between where those
 * above push them and where those below do, so none overlaps another as long as there is room.
 * @param {number[]} wanted @param {number} height @param {Span} span */
export function apart(wanted, height, [top, bottom]) {
  const order = wanted.map((_, place) => place).sort((a, b) => wanted[a] - wanted[b] || a - b);
  const [down, up] = [[...wanted], [...wanted]];
  for (let i = 1; i < order.length; i++) {
    const [above, below] = [order.length - i - 1, order.length - i];
    down[order[i]] = Math.max(down[order[i]], down[order[i - 1]] + height);
    up[order[above]] = Math.min(up[order[above]], up[order[below]] - height);
  }
  return wanted.map((_, place) => {
    const rank = order.indexOf(place);
    return Math.max(top + rank * height, Math.min((down[place] + up[place]) / 2, bottom - (order.length - 1 - rank) * height));
  });
}
