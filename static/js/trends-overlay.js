// What lies over and above the curves, as elements over the canvas: the lanes of alarms and notes, the events, the cursors A
// and B, and hatching where nothing was read. Places are percent of the span.

/** Height of a row of the lanes, and what is below them. */
const [ROW, GAP] = [22, 6];
const PRIORITIES = ["urgent", "high", "medium", "low"];
/** Percent that a name needs at least. */
const LEAST_ROOM = 12;

/** Where each alarm of a span begins and ends, and whose it is: `row` counts the priorities that occur, the most important at
 * the top; `room` is how much is free after it in its row. The most important is drawn last, over others.
 * @param {Alarm[]} alarms @param {Span} span @returns {PlacedAlarm[]} */
export function placed(alarms, [from, to]) {
  /** @param {number} t */
  const percent = (t) => (100 * (Math.min(Math.max(t, from), to) - from)) / (to - from);
  const shown = alarms.map((alarm, place) => ({ ...alarm, index: place })).filter(({ t, until }) => t < to && (until ?? to) > from);
  const rows = PRIORITIES.filter((priority) => shown.some((alarm) => alarm.priority === priority));
  const marks = shown.map((alarm) => ({
    ...alarm,
    row: rows.indexOf(alarm.priority),
    x: percent(alarm.t),
    end: percent(alarm.until ?? to),
    label: [alarm.place, alarm.name].filter(Boolean).join(" · "),
  }));
  return marks
    .map((mark) => {
      const after = marks.filter((other) => other !== mark && other.row === mark.row && other.x >= mark.x);
      return { ...mark, room: Math.min(100, ...after.map(({ x }) => x)) - mark.end };
    })
    .sort((a, b) => b.row - a.row || a.x - b.x);
}

/** How many rows the alarms of a span take; at least one, so that the chart does not move with the first.
 * @param {Alarm[]} alarms @param {Span} span */
export const alarmRows = (alarms, span) => Math.max(1, ...placed(alarms, span).map(({ row }) => row + 1));

/** Height of the lanes above the curves, in pixels. @param {Overlay} overlay @param {Span} span */
export const lanesHeight = ({ alarms, notes }, span) => (alarmRows(alarms, span) + (notes.length ? 1 : 0)) * ROW + GAP;

/** A plugin of uPlot that shows what `shown()` gives. `words`: null for the lanes of bits, which have no alarms above them.
 * @param {() => { overlay: Overlay, span: Span, unknown: Span[] }} shown @param {LaneWords | null} words @returns {uPlot.Plugin} */
export function overlayPlugin(shown, words) {
  const layer = document.createElement("div");
  layer.className = "trends__over";
  layer.ariaHidden = "true";
  return {
    hooks: {
      ready: (plot) => plot.over.after(layer),
      draw: (plot) => {
        const { overlay, span, unknown } = shown();
        layer.style.cssText = plot.over.style.cssText;
        layer.replaceChildren(...lines(overlay, span, unknown, words?.late ?? ""), ...(words ? lanes(overlay, span, words) : []));
      },
    },
  };
}

/** @param {string} className @param {Record<string, number | string>} place @param {string} [text] */
function part(className, place, text = "") {
  const element = document.createElement("span");
  element.className = className;
  element.textContent = text;
  for (const [name, value] of Object.entries(place)) element.style.setProperty(name, typeof value === "number" ? `${value}%` : value);
  return element;
}

/** What is as high as the chart. @param {Overlay} overlay @param {Span} span @param {Span[]} unknown @param {string} late */
function lines({ marks, notes, a, b }, [from, to], unknown, late) {
  /** @param {number} t */
  const left = (t) => (100 * (t - from)) / (to - from);
  /** @param {Span} of */
  const between = ([begun, end]) => {
    const x = Math.max(0, left(begun));
    return { left: x, width: Math.min(100, left(end)) - x };
  };
  /** @param {number | null} t @param {string} kind @param {string} [text] */
  const line = (t, kind, text) => (t === null || t < from || t > to ? [] : [part(`trends__line trends__line--${kind}`, { left: left(t) }, text)]);
  return [
    ...unknown.map((of) => part("trends__unknown", between(of))),
    ...marks.flatMap(({ t, until }) => {
      if (until === null) return line(t, "event");
      const place = between([t, until]);
      return place.width < 0 || place.left > 100 ? [] : [part("trends__late", { ...place, direction: place.left > 50 ? "rtl" : "ltr" }, late)];
    }),
    ...notes.flatMap(({ t }) => line(t, "note")),
    ...line(a, "cursor", "A"),
    ...line(b, "cursor", "B"),
  ];
}

/** @param {Overlay} overlay @param {Span} span @param {LaneWords} words */
function lanes({ alarms, notes }, [from, to], words) {
  const rows = alarmRows(alarms, [from, to]);
  const height = (rows + (notes.length ? 1 : 0)) * ROW;
  /** @param {number} row */
  const top = (row) => `${row * ROW - height - GAP}px`;
  /** @param {HTMLElement} element @param {"alarms" | "notes"} list @param {number} index */
  const item = (element, list, index) => {
    Object.assign(element.dataset, { list, index });
    return element;
  };
  /** @param {string} word @param {number} row @param {number} count */
  const lane = (word, row, count) => {
    const ground = part("trends__lane", { top: top(row), height: `${count * ROW}px` });
    ground.append(part("", {}, word));
    return ground;
  };
  return [
    lane(words.alarms, 0, rows),
    ...(notes.length ? [lane(words.notes, rows, 1)] : []),
    ...placed(alarms, [from, to]).flatMap(({ index, priority, row, x, end, room, label }) => {
      const mark = item(part("trends__alarm alarm-priority", { left: x, top: top(row), width: end - x }), "alarms", index);
      mark.dataset.is = priority;
      mark.append(part("alarm-priority__shape", {}));
      return room < LEAST_ROOM ? [mark] : [part("trends__who", { left: end, top: top(row), "max-width": room }, label), mark];
    }),
    ...notes.flatMap(({ t }, i) => {
      const left = (100 * (t - from)) / (to - from);
      return t < from || t > to ? [] : [item(part("trends__flag", { left, top: top(rows) }, String(i + 1)), "notes", i)];
    }),
  ];
}
