// The page for no connection: it looks again by itself, and goes where it was asked to go.
const EVERY_MS = 3000;

async function look() {
  try {
    const answer = await fetch("/healthz", { cache: "no-store", signal: AbortSignal.timeout(EVERY_MS) });
    if (!answer.ok) return;
  } catch {
    return;
  }
  if (location.pathname !== "/offline") location.replace(location.href);
}

setInterval(look, EVERY_MS);
addEventListener("online", look);
