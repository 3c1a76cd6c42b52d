// Ten minutes in each tile: the actual speed over the dashed setpoint, where the tile has room for it. All tiles by one
// request, as often as the newest point moves by two pixels; an hour of a page that nobody looks at costs none.
import { isLive } from "./live.js";
import { drawing, fetchMinutes, outline, path, range } from "./spark.js";

const EVERY_MS = 10_000;

const tiles = Array.from(document.querySelectorAll("[data-spark]"), (place) => {
  const lines = { commanded: path("spark__commanded"), actual: path("spark__actual") };
  place.append(drawing(lines.commanded, lines.actual));
  return { place, unit: place.getAttribute("data-spark") ?? "", lines };
});

async function draw() {
  const visible = tiles.filter(({ place }) => place.getClientRects().length);
  if (!visible.length || !isLive() || document.visibilityState !== "visible") return;
  const { from, found } = await fetchMinutes(visible.map(({ unit }) => unit));
  for (const { unit, lines } of visible) {
    const [actual, commanded] = [found[`${unit}/actual`], found[`${unit}/commanded`]];
    const scale = range([...actual.avg, ...commanded.avg]);
    lines.actual.setAttribute("d", scale ? outline(actual, from, scale, false) : "");
    lines.commanded.setAttribute("d", scale ? outline(commanded, from, scale, true) : "");
  }
}

const again = () => draw().catch(() => {});
document.addEventListener("lineside:found", again);
again();
setInterval(again, EVERY_MS);
