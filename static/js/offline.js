// The offline page: it retries automatically, then opens the requested page.
const EVERY_MS = 3000;

async function look() {
  try {
    const response = await fetch("/healthz", { cache: "no-store", signal: AbortSignal.timeout(EVERY_MS) });
    if (!response.ok) return;
  } catch {
    return;
  }
  if (location.pathname !== "/offline") location.replace(location.href);
}

setInterval(look, EVERY_MS);
addEventListener("online", look);
