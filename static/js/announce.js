// Announces the result of a part that is swapped in once: data-announce holds the text. Few screen readers read a
// live region that is inserted together with its text, and one that counts would never stop. The verdict of the line
// has another region: of two texts that are put into one at the same moment, the first would be lost.
const announcement = () => document.querySelector("[data-announce]")?.dataset.announce ?? "";

export function start() {
  let last = announcement();
  document.addEventListener("htmx:after:swap", () => {
    const now = announcement();
    if (now && now !== last) document.getElementById("announcement").textContent = now;
    last = now;
  });
}
