// Stretches the cells of the line page over the window: from its size and the number of units follows the number of
// columns. CSS does the rest, and a page of as many columns as fit where this script is not there.

/** Width and height in px below which a cell cannot be read or pressed; the strip above it, and the gap. In a window as
 * narrow as a phone, *Auto* puts two tiles into a row. */
const SIZES = {
  phone: { width: 140, height: 84, strip: 18, gap: 8 },
  tiles: { width: 186, height: 110, strip: 22, gap: 8 },
  matrix: { width: 74, height: 48, strip: 16, gap: 3 },
};
/** Of a page that scrolls anyway: there a tile has two lines of a cause, and its time. */
const SCROLLED_PX = 126;
const PHONE_PX = 576;
/** What is blank at the end of a narrow page, above the bar at its edge. */
const BLANK_PX = 32;
/** A cell is as good as the smaller of its width and so many times its height. */
const SHAPE = 1.6;

/** @typedef {{ columns: number, width: number, height: number }} Fit */

/** How many columns show lines of so many units each in a window best: cells of a good shape, few places empty, and all
 * of them visible where that is possible.
 * @param {number[]} units @param {number} width @param {number} height @param {{ width: number, height: number,
 * strip: number, gap: number }} least @returns {Fit} */
export function fitOf(units, width, height, least) {
  const most = Math.max(1, Math.floor((width + least.gap) / (least.width + least.gap)));
  const all = units.reduce((sum, count) => sum + count, 0);
  const rowsOf = (/** @type {number} */ columns) =>
    units.reduce((sum, count) => sum + Math.ceil(count / columns), 0);
  // Where not all are visible: as few rows as possible, and no more places than they need.
  let fewest = most;
  while (fewest > 1 && rowsOf(fewest - 1) === rowsOf(most)) fewest -= 1;
  /** @type {Fit} */
  let best = { columns: fewest, width: cellWidth(fewest, width, least.gap), height: least.height };
  let goodness = 0;
  for (let columns = 1; columns <= most; columns += 1) {
    const rows = rowsOf(columns);
    const fit = {
      columns,
      width: cellWidth(columns, width, least.gap),
      height: height / rows - least.strip - least.gap,
    };
    if (fit.height < least.height) continue;
    const good = Math.min(fit.width, SHAPE * fit.height) * (all / (rows * columns));
    if (good <= goodness) continue;
    goodness = good;
    best = fit;
  }
  return best;
}

/** The same for a number of columns that stays: beside a faceplate no unit leaves its row. Null where that is too narrow.
 * @param {number} columns @param {number[]} units @param {number} width @param {number} height @param {{ width: number,
 * height: number, strip: number, gap: number }} least @returns {Fit | null} */
export function fitWith(columns, units, width, height, least) {
  const rows = units.reduce((sum, count) => sum + Math.ceil(count / columns), 0);
  const kept = cellWidth(columns, width, least.gap);
  if (kept < least.width) return null;
  return { columns, width: kept, height: Math.max(least.height, height / rows - least.strip - least.gap) };
}

/** @param {number} columns @param {number} width @param {number} gap */
const cellWidth = (columns, width, gap) => (width - gap * (columns - 1)) / columns;

/** A cause is seldom longer. */
const LETTERS = 64;
const [LETTER_PX, LINE_PX, BESIDE_PX, ABOVE_PX] = [6.3, 13.2, 12, 28];

/** A large cell shows a cause beside all that it shows without one, a medium one in its place, and a small one none.
 * @param {Fit} fit */
export function sizeOf({ width, height }) {
  if (width >= 190 && height >= 148 + Math.min(0.09 * width, 32)) return "large";
  const number = 1.2 * Math.min(0.2 * width, 0.36 * height);
  const lines = Math.ceil((LETTERS * LETTER_PX) / (width - BESIDE_PX));
  return height >= ABOVE_PX + number + lines * LINE_PX ? "medium" : "small";
}

/** So many tiles have the last ten minutes in the place of a cause; more would cost a panel too much. */
const MOST_TRENDS = 12;

/** Whether cells of a size show the last ten minutes where a cause would be. @param {string} size @param {number} count */
export const showsTrends = (size, count) => size === "medium" && count <= MOST_TRENDS;

/** The number of columns, and the window that it was counted for. */
let counted = { columns: 0, of: "" };

/** @param {HTMLElement} line */
function fit(line) {
  const webs = [...line.querySelectorAll(".web")];
  if (!webs.length) return;
  const boxes = webs.map((web) => web.getBoundingClientRect());
  const around = line.getBoundingClientRect().height - boxes.reduce((sum, box) => sum + box.height, 0);
  const below = Number.parseFloat(getComputedStyle(line.parentElement ?? line).paddingBlockEnd);
  const { top } = line.getBoundingClientRect();
  // On a narrow screen what is counted stands below the units: in the window, or where it has no room there, outside of it.
  const totals = document.querySelector(".totals")?.getBoundingClientRect();
  const recipes = document.querySelector(".totals__recipes")?.getBoundingClientRect().height ?? 0;
  const under = totals && totals.top > top ? totals.height - recipes : 0;
  const height = innerHeight - top - scrollY - Math.max(0, around) - below + (under ? BLANK_PX : 0);
  const isPhone = innerWidth < PHONE_PX && "auto" in line.dataset;
  const least = SIZES[isPhone ? "phone" : line.matches(".line--tiles") ? "tiles" : "matrix"];
  const units = webs.map((web) => web.childElementCount);
  const present = `${innerWidth} ${innerHeight}`;
  const fitIn = (/** @type {number} */ room) =>
    (counted.of === present ? fitWith(counted.columns, units, boxes[0].width, room, least) : null) ??
    fitOf(units, boxes[0].width, room, least);
  let found = fitIn(height - under);
  if (under && found.height <= least.height) found = fitIn(height);
  counted = { columns: found.columns, of: present };
  const isTall = least === SIZES.tiles && found.height <= least.height;
  if (isTall) found = { ...found, height: SCROLLED_PX };
  line.toggleAttribute("data-scrolls", isTall);
  line.dataset.size = isPhone ? "phone" : sizeOf(found);
  line.toggleAttribute("data-trends", showsTrends(line.dataset.size, line.querySelectorAll(".web > *").length));
  line.style.setProperty("--columns", String(found.columns));
  line.style.setProperty("--cell-width", `${found.width.toFixed(1)}px`);
  line.style.setProperty("--cell-height", `${found.height.toFixed(1)}px`);
  for (const web of webs) arrange(web, found.columns);
}

/** Mark where rows begin, and how many cells the name of a group may take there.
 * @param {HTMLElement} web @param {number} columns */
function arrange(web, columns) {
  const places = /** @type {HTMLElement[]} */ ([...web.children]);
  web.parentElement?.style.setProperty("--rows", String(Math.ceil(places.length / columns)));
  let named = -1;
  const end = (/** @type {number} */ at) => named >= 0 && places[named].style.setProperty("--span", String(at - named));
  places.forEach((place, at) => {
    const isRowStart = at % columns === 0;
    place.toggleAttribute("data-row-start", isRowStart);
    if (!isRowStart && !place.matches(".web__place--first")) return;
    end(at);
    named = at;
  });
  end(places.length);
}

/** @param {HTMLElement} line */
function follow(line) {
  let [width, height] = [0, 0];
  new ResizeObserver(() => {
    const { clientWidth } = line.querySelector(".line__buses") ?? line;
    if (clientWidth === width && innerHeight === height) return;
    [width, height] = [clientWidth, innerHeight];
    fit(line);
  }).observe(line.querySelector(".line__buses") ?? line);
  addEventListener("resize", () => fit(line));
  // The strip of the change tray takes room below.
  document.addEventListener("lineside:changed", () => fit(line));
}

const shown = globalThis.document?.querySelector(".line");
if (shown) {
  fit(shown);
  follow(shown);
}
