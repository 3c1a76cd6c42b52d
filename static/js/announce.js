// Announces the result of a part that is swapped in once: data-announce holds the text. Few screen readers read a
// live region that is inserted together with its text, and one that counts would never stop.
const announcement = () => document.querySelector("[data-announce]")?.dataset.announce ?? "";

export function start() {
  let last = announcement();
  document.addEventListener("htmx:after:swap", () => {
    const now = announcement();
    if (now && now !== last) document.getElementById("verdict").textContent = now;
    last = now;
  });
}
