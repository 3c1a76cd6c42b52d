// The speed of a unit from a minute before its alarm came: ten minutes, with a mark where it came.
import "./main.js";
import { now } from "./clock.js";
import { build, nameExtremes } from "./minutes.js";
import { outline, path, range } from "./spark.js";
import { formatTime } from "./site-time.js";

const BEFORE_S = 60;
const SPAN_S = 600;
const figure = document.querySelector("[data-alarm-trend]");

/** @param {HTMLElement} figure @param {string} unit @param {number} came */
async function draw(figure, unit, came) {
  const from = came - BEFORE_S;
  const query = new URLSearchParams([
    ["series", `${unit}/actual`],
    ["series", `${unit}/commanded`],
    ["from", new Date(from * 1000).toISOString()],
    ["to", new Date(Math.min(now(), from + SPAN_S) * 1000).toISOString()],
    ["format", "epoch"],
  ]);
  const response = await fetch(`/api/v1/history/sparks?${query}`);
  if (!response.ok) return;
  const found = await response.json();
  const [actual, commanded] = [found[`${unit}/actual`], found[`${unit}/commanded`]];
  const all = [...actual.avg, ...commanded.avg];
  const scale = range(all);
  if (!scale) return;
  const { lines, labels } = build(figure);
  lines.actual.setAttribute("d", outline(actual, from, scale, false));
  lines.commanded.setAttribute("d", outline(commanded, from, scale, true));
  const mark = path("minutes__came");
  mark.setAttribute("d", `M${BEFORE_S} 0V100`);
  lines.actual.before(mark);
  nameExtremes(unit, labels, all, scale);
  for (const [index, at] of [from, from + SPAN_S].entries()) labels[2 + index].textContent = formatTime(at, "clock");
}

if (figure) {
  const { alarmTrend, came } = figure.dataset;
  draw(figure, alarmTrend, Number(came)).catch(() => {});
}
