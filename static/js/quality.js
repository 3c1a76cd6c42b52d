// How old every value is, against the server's clock. The quality from the server can only be lowered here,
// never better: if the page stops hearing of a unit, its values grow stale by themselves.

import { fieldsOf } from "./bind.js";
import * as clock from "./clock.js";
import { giveBack } from "./focus.js";
import { put, span, word } from "./words.js";

const CHECK_MS = 250;
/** @type {Shown[]} */
let units = [];
/** @type {Shown[]} */
let ages = [];
let turn = 0;

/** Find the containers again: once, and after a fragment came in. */
export function findUnits() {
  units = [...document.querySelectorAll("[data-unit]")].map((element) => ({
    element,
    unit: element.dataset.unit,
    marked: "",
  }));
  ages = [...document.querySelectorAll("[data-age]")].map((element) => ({
    element,
    unit: element.dataset.age,
  }));
  check();
}

/** online, stale, offline or unknown.
 * @param {string} unit */
export function qualityOf(unit) {
  const fields = fieldsOf(unit);
  if (!fields?.at) return "unknown";
  if (fields.link !== "online") return fields.link ?? "unknown";
  const bus = fieldsOf(unit.slice(0, unit.indexOf("/")));
  const age = clock.now() - Number(fields.at);
  if (age > Number(bus?.offline_after)) return "offline";
  return age > Number(bus?.stale_after) ? "stale" : "online";
}

/** @param {string} unit */
function ageOf(unit) {
  const at = fieldsOf(unit)?.at;
  if (!at) return word("never");
  const age = span(clock.now() - Number(at));
  return qualityOf(unit) === "online" ? age : word("lastResponse", age);
}

/** How long ago a unit responded last that is not live now, in words; "" of one that is, or that never did.
 * @param {string} unit */
export const silenceOf = (unit) => (fieldsOf(unit)?.at && qualityOf(unit) !== "online" ? ageOf(unit) : "");

function check() {
  if (document.body.dataset.link !== "live") return;
  for (const one of units) {
    const quality = qualityOf(one.unit);
    if (one.marked !== quality) mark(one, quality);
  }
  if (turn++ % 4 === 0) {
    for (const { element, unit } of ages) put(element, ageOf(unit));
  }
}

/** @param {Shown} one @param {string} quality */
function mark(one, quality) {
  one.marked = quality;
  one.element.dataset.quality = quality;
  for (const acts of one.element.querySelectorAll(".acts")) acts.inert = quality !== "online";
  if (quality === "online") giveBack();
}

export const start = () => setInterval(check, CHECK_MS);
