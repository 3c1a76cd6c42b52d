// How the cells of the line page fill a window of any size.
import assert from "node:assert/strict";
import { test } from "node:test";
import { fitOf, fitWith, showsTrends, sizeOf } from "../../static/js/line-fit.js";

const TILES = { width: 186, height: 110, strip: 22, gap: 8 };
const MATRIX = { width: 74, height: 48, strip: 16, gap: 3 };
/** The room for the line in a window of 1280 × 800 and of 1920 × 1080. */
const [PANEL, WALL] = [
  [1144, 568],
  [1784, 850],
];
const rowsOf = (units, { columns }) => Math.ceil(units / columns);
const heightOf = (units, fit, least) => rowsOf(units, fit) * (fit.height + least.strip + least.gap);

test("8 to 16 units are visible together on a panel", () => {
  for (let units = 8; units <= 16; units += 1) {
    const fit = fitOf([units], ...PANEL, TILES);
    assert.ok(fit.height >= TILES.height && fit.width >= TILES.width, `${units}`);
    assert.ok(heightOf(units, fit, TILES) <= PANEL[1] + 0.01, `${units}`);
  }
});

test("255 units are visible together on a wall", () => {
  const fit = fitOf([255], ...WALL, MATRIX);
  assert.ok(heightOf(255, fit, MATRIX) <= WALL[1] + 0.01);
  assert.ok(fit.width >= MATRIX.width && fit.height >= MATRIX.height);
});

test("any number of units fills a window", () => {
  for (let units = 1; units <= 255; units += 1) {
    const fit = fitOf([units], ...WALL, MATRIX);
    assert.ok(heightOf(units, fit, MATRIX) > WALL[1] - 0.01, `${units}`);
    assert.ok(fit.columns * (fit.width + MATRIX.gap) > WALL[0], `${units}`);
    assert.ok(rowsOf(units, fit) * fit.columns - units < fit.columns, `${units}`);
  }
});

test("eight units are two rows of four", () => assert.equal(fitOf([8], ...PANEL, TILES).columns, 4));

test("what fits no window has as many columns as can be read, and scrolls", () => {
  const fit = fitOf([255], ...PANEL, MATRIX);
  assert.equal(fit.columns, 14);
  assert.equal(fit.height, MATRIX.height);
  assert.equal(fitOf([8], 40, 600, TILES).columns, 1);
});

test("what fits no window leaves no more places empty than its last row has", () => {
  assert.equal(fitOf([16], PANEL[0], 400, TILES).columns, 4);
  assert.equal(fitOf([100], PANEL[0], 300, MATRIX).columns, 13);
});

test("the lines of several buses have one number of columns", () => {
  const fit = fitOf([3, 9], ...PANEL, TILES);
  assert.ok((Math.ceil(3 / fit.columns) + Math.ceil(9 / fit.columns)) * (fit.height + 30) <= PANEL[1] + 0.01);
});

test("beside a faceplate no unit leaves its row, unless a cell would be too narrow", () => {
  const { columns } = fitOf([8], ...PANEL, TILES);
  assert.equal(fitWith(columns, [8], PANEL[0] - 364, PANEL[1], TILES)?.columns, columns);
  assert.equal(fitWith(columns, [8], 600, PANEL[1], TILES), null);
});

test("a cause is shown where it has room", () => {
  assert.equal(sizeOf({ columns: 4, width: 277, height: 254 }), "large");
  assert.equal(sizeOf({ columns: 4, width: 278, height: 174 }), "large");
  assert.equal(sizeOf({ columns: 3, width: 427, height: 174 }), "medium");
  assert.equal(sizeOf({ columns: 10, width: 170, height: 121 }), "medium");
  assert.equal(sizeOf({ columns: 22, width: 76, height: 50 }), "small");
});

test("the last ten minutes are in the place of a cause of up to twelve medium tiles", () => {
  assert.deepEqual([8, 11, 12, 16].map((count) => showsTrends("medium", count)), [true, true, true, false]);
  assert.equal(showsTrends("small", 8), false);
});
