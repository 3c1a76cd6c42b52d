// Runs before the first paint: the user's choice of light or dark, else the device's.
(() => {
  const root = document.documentElement;
  const read = () => {
    try {
      return localStorage.getItem("lineside-theme");
    } catch {
      return null;
    }
  };
  const chosen = read();
  if (chosen === "light" || chosen === "dark") root.dataset.theme = chosen;

  document.addEventListener("click", (event) => {
    if (!event.target.closest?.("[data-theme-toggle]")) return;
    const dark = root.dataset.theme
      ? root.dataset.theme === "dark"
      : matchMedia("(prefers-color-scheme: dark)").matches;
    root.dataset.theme = dark ? "light" : "dark";
    try {
      localStorage.setItem("lineside-theme", root.dataset.theme);
    } catch {
      // A browser that keeps nothing still toggles for this page.
    }
  });
})();
