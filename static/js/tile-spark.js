// Ten minutes in each tile: the actual speed over the dashed setpoint in its at-speed band, where there is room for it. All tiles by one
// request, as often as the newest point moves by two pixels; a tile without room and an hour of a page that nobody looks at cost none.
import { isLive } from "./live.js";
import { band, drawing, fetchMinutes, outline, path, range } from "./spark.js";

const EVERY_MS = 10_000;

const tiles = Array.from(document.querySelectorAll("[data-spark]"), (place) => {
  const lines = { band: path("spark__band"), commanded: path("spark__commanded"), actual: path("spark__actual") };
  place.append(drawing(lines.band, lines.commanded, lines.actual));
  const { spark: unit = "", window = "" } = /** @type {HTMLElement} */ (place).dataset;
  return { place, unit, window: Number(window), lines };
});

async function draw() {
  const visible = tiles.filter(({ place }) => place.getBoundingClientRect().height >= 1);
  if (!visible.length || !isLive() || document.visibilityState !== "visible") return;
  const { from, found } = await fetchMinutes(visible.map(({ unit }) => unit));
  for (const { unit, window, lines } of visible) {
    const [actual, commanded] = [found[`${unit}/actual`], found[`${unit}/commanded`]];
    const scale = range([...actual.avg, ...commanded.avg], window);
    lines.band.setAttribute("d", scale && window ? band(commanded, from, scale, window) : "");
    lines.actual.setAttribute("d", scale ? outline(actual, from, scale, false) : "");
    lines.commanded.setAttribute("d", scale ? outline(commanded, from, scale, true) : "");
  }
}

const again = () => draw().catch(() => {});
document.addEventListener("lineside:found", again);
again();
setInterval(again, EVERY_MS);
