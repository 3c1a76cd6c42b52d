// Notes on the chart: each is about a time. They are the notes of the shift, so the hand-over sheet has them too.
import { formatTime } from "./site-time.js";
import { writeNote } from "./trends-data.js";
import { fromField, toField } from "./trends-time.js";

/** Let a person write one, where the page has the form. `time` gives what it is about: the cursor, else now; `written`
 * is called once it is stored, and `why` gives the text of an error.
 * @param {TrendWords} words @param {() => number} time @param {() => void} written @param {(error: unknown) => string} why */
export function bindNotes(words, time, written, why) {
  const form = document.getElementById("trend-note");
  if (!form) return;
  const details = form.closest("details");
  const result = document.getElementById("trend-note-result");
  /** A request that is sent again stores its note once. */
  let key = newKey();
  details?.addEventListener("toggle", () => {
    if (details.open && !form.elements.text.value) form.elements.time.value = toField(time());
  });
  form.addEventListener("input", () => {
    key = newKey();
  });
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const { text, unit } = form.elements;
    const about = fromField(form.elements.time.value);
    if (Number.isNaN(about)) {
      result.textContent = words.malformed;
      return;
    }
    const [button] = form.querySelectorAll("button");
    button.disabled = true;
    try {
      await writeNote({ time: about, text: text.value, unit: unit.value, key });
      text.value = "";
      key = newKey();
      result.textContent = words.stored;
      written();
    } catch (error) {
      result.textContent = why(error);
    } finally {
      button.disabled = false;
    }
  });
}

const newKey = () => `${Date.now()}-${Math.random()}`;

/** A note in a list, with the number that its flag has.
 * @param {Note} note @param {number} place @param {(bus: string, unit: number | null) => string} name */
export function noteContent({ t, who, text, bus, unit }, place, name) {
  const where = bus ? ` · ${name(bus, unit)}` : "";
  return [`${place + 1} · ${formatTime(t)}${where} · ${text} (${who})`];
}
