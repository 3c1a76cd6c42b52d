// The legend: what each line is, and what it reads at the cursor or last; a press dims a line, or all others.
import { element, refill } from "./element.js";
import { formatTime } from "./site-time.js";
import { lastValue, valueAt } from "./trends-data.js";
import { swatch } from "./trends-look.js";
import { shownValue } from "./trends-values.js";

export class Legend {
  /** `toggle` dims the line of a series, or ends that; `only` dims all others.
   * @param {HTMLElement} list @param {HTMLElement} time @param {TrendWords} words
   * @param {{ toggle: (key: string) => void, only: (key: string) => void }} on */
  constructor(list, time, words, { toggle, only }) {
    this.list = list;
    this.time = time;
    this.words = words;
    /** @type {{ curve: Curve, past: Curve | undefined, value: HTMLElement, before: HTMLElement }[]} */
    this.rows = [];
    this.drawn = "";
    list.addEventListener("click", ({ target }) => {
      const button = target.closest("button");
      if (button?.dataset.only) only(button.dataset.only);
      else if (button?.dataset.key) toggle(button.dataset.key);
    });
  }

  /** One row for each curve, with what it was in the time compared. The rows are made again only where the curves are
   * others, so that none moves under a finger.
   * @param {Curve[]} curves @param {Curve[]} past */
  draw(curves, past) {
    const names = JSON.stringify(curves.map(({ key, name }) => [key, name]));
    if (names !== this.drawn) this.make(curves);
    this.drawn = names;
    this.rows.forEach((row, i) => {
      row.curve = curves[i];
      row.past = past.find(({ key }) => key === curves[i].key);
      const button = row.value.closest("button");
      button?.setAttribute("aria-checked", String(!curves[i].dimmed));
    });
  }

  /** @param {Curve[]} curves */
  make(curves) {
    this.rows = curves.map((curve) => ({ curve, past: undefined, value: element("b"), before: element("small") }));
    const { only, onlyThis } = this.words;
    refill(
      this.list,
      this.rows.map(({ curve: { key, name, place, value: kind }, value, before }) =>
        element(
          "li",
          {},
          {},
          element("button", { type: "button", role: "switch" }, { key }, swatch(place, kind), element("bdi", {}, {}, `${place + 1} ${name}`), value, before),
          element("button", { type: "button", ariaLabel: `${onlyThis}: ${name}` }, { key: `only ${key}`, only: key }, only),
        ),
      ),
    );
  }

  /** What all read at a time, or last within a span. @param {number | null} at @param {Span} range */
  show(at, range) {
    this.time.textContent = at === null ? this.words.latest : formatTime(at);
    for (const { curve, past, value, before } of this.rows) {
      /** @param {Curve} of */
      const read = (of) => (at === null ? lastValue(of, range) : valueAt(of, at));
      value.textContent = withMeasure(curve, read(curve));
      before.textContent = past ? shownValue(past, at === null ? null : read(past)) : "";
    }
  }
}

/** @param {Curve} curve @param {number | null} value */
const withMeasure = (curve, value) =>
  shownValue(curve, value) + (value !== null && curve.measure ? ` ${curve.measure}` : "");
