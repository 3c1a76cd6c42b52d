// Keeps nothing of the line: old values must never look like new ones. Only one page is kept, the one that shows that
// there is no connection. OFFLINE and KEPT stand above this text, written by the server.
const CACHE = "lineside-offline";

self.addEventListener("install", (event) => {
  event.waitUntil(
    (async () => {
      await caches.delete(CACHE);
      const cache = await caches.open(CACHE);
      await cache.addAll([OFFLINE, ...KEPT]);
      await self.skipWaiting();
    })(),
  );
});

self.addEventListener("activate", (event) => event.waitUntil(self.clients.claim()));

/** @param {string} path */
const kept = async (path) => (await caches.match(path)) ?? Response.error();

/** What was sent and did not arrive is not sent again: the way leads back to the page that it was sent from.
 * @param {Request} request */
async function visit(request) {
  try {
    return await fetch(request);
  } catch {
    if (request.method !== "GET") return Response.redirect(request.referrer || "/", 303);
    return kept(OFFLINE);
  }
}

self.addEventListener("fetch", (event) => {
  const { request } = event;
  const path = new URL(request.url).pathname;
  if (request.mode === "navigate") event.respondWith(visit(request));
  else if (KEPT.includes(path)) event.respondWith(fetch(request).catch(() => kept(path)));
});
