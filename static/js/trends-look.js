// How the line of a value looks: a hue, a dash and a number, so that eight lines differ for every eye.
const HUES = 8;
/** Pixels drawn and left out in turn. Only the first is solid. @type {number[][]} */
const DASHES = [[], [12, 4], [5, 3], [14, 4, 3, 4], [24, 5], [14, 4, 3, 4, 3, 4], [6, 3, 6, 9], [3, 3, 3, 3, 3, 9]];
/** In the place of the solid one, because what is commanded is always dashed. */
const COMMANDED = [9, 9];
/** Of an earlier time: narrow, dotted and lighter. */
export const PAST = { dash: [1, 3], percent: 70, width: 1.5 };
/** How much is left of a dimmed line. */
export const DIMMED = 0.18;
const NUMBERS = ["commanded", "actual", "analog", "draw"];

/** Whether it is shown as a lane and not as a curve. @param {{ value: string }} result */
export const isBit = (result) => !NUMBERS.includes(result.value);

/** Custom property with the hue, and the dash of a value at a place: 32 values differ in one of the two.
 * @param {number} place @param {string} [value] */
export function look(place, value = "") {
  const shift = (Math.floor(place / HUES) % 4) * 3;
  const dash = DASHES[(place + shift) % DASHES.length];
  return { name: `--curve-${(place % HUES) + 1}`, dash: dash.length || value !== "commanded" ? dash : COMMANDED };
}

/** A short piece of the line, for a legend. `past`: of an earlier time.
 * @param {number} place @param {string} value */
export function swatch(place, value, past = false) {
  const { name, dash } = look(place, value);
  const [svg, path] = ["svg", "path"].map((tag) => document.createElementNS("http://www.w3.org/2000/svg", tag));
  svg.setAttribute("class", past ? "trends__swatch trends__swatch--past" : "trends__swatch");
  svg.setAttribute("viewBox", "0 0 40 8");
  svg.setAttribute("aria-hidden", "true");
  path.setAttribute("d", "M0 4h40");
  path.style.stroke = `var(${name})`;
  const drawn = past ? PAST.dash : dash;
  if (drawn.length) path.setAttribute("stroke-dasharray", drawn.join(" "));
  svg.append(path);
  return svg;
}

/** @type {Map<string, string>} */
const colors = new Map();

/** A color that light-dark() gives, as the canvas understands it; `percent` of it, the rest shines through. To
 * find one out costs a computation of style, and every mark needs one at every redraw.
 * @param {string} name */
export function colour(name, percent = 100) {
  const key = `${name} ${percent}`;
  const found = colors.get(key) ?? foundColor(name, percent);
  colors.set(key, found);
  return found;
}

/** The theme has changed. */
export const forgetColors = () => colors.clear();

/** @param {string} name */
export const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** @param {string} name @param {number} percent */
function foundColor(name, percent) {
  const probe = document.createElement("i");
  const color = css(name) ? `var(${name})` : "currentcolor";
  probe.style.color = percent < 100 ? `color-mix(in srgb, ${color} ${percent}%, transparent)` : color;
  document.body.append(probe);
  const found = getComputedStyle(probe).color;
  probe.remove();
  return found;
}
