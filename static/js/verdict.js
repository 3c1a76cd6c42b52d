// The verdict outside of its place on the page: in the title of the tab, and spoken by a screen reader.
import { listen } from "./bind.js";

const title = document.title;

/** A translation of the page writes a title, too.
 * @param {number} abnormal */
function entitle(abnormal) {
  const present = abnormal > 0 ? `(${abnormal}) ${title}` : title;
  if (document.title !== present) document.title = present;
}

/** To a screen reader: only when it is more or less than before, never at first, and not each unit on its ramp.
 * @param {string} verdict */
function announce(verdict) {
  const place = document.getElementById("verdict");
  if (place) place.textContent = verdict;
}

export function start() {
  /** @type {string | undefined} */
  let known;
  listen("line_summary", (fields) => {
    entitle(Number(fields.abnormal));
    if (known !== undefined && fields.abnormal !== known) announce([fields.verdict, fields.counts].filter(Boolean).join(" · "));
    known = fields.abnormal ?? known;
  });
}
