// What a part that is drawn anew has come to is said aloud once: data-told holds the sentence. A live region that
// comes with the part itself is heard by few screen readers, and one that counts would never be silent.
const told = () => document.querySelector("[data-told]")?.dataset.told ?? "";

export function start() {
  let last = told();
  document.addEventListener("htmx:after:swap", () => {
    const now = told();
    if (now && now !== last) document.getElementById("verdict").textContent = now;
    last = now;
  });
}
