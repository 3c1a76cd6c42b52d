// The parts of a page that modules of static/js read when they are loaded, and a clock that the test advances.
// Open a page first, then `await import()` the module: an import statement would come before it.

/** Replace the page of this process; `clock.ms` is what performance.now() returns. */
export function openPage({ language = "en", zone = "UTC", time = 0, address = "", words = {} } = {}) {
  const clock = { ms: 0 };
  performance.now = () => clock.ms;
  const parts = { words: { dataset: words } };
  globalThis.document = {
    hidden: false,
    body: { dataset: { now: String(time), zone } },
    documentElement: { lang: language },
    getElementById: (id) => parts[id] ?? null,
    querySelectorAll: () => [],
  };
  globalThis.location = { search: address };
  globalThis.history = {
    replaceState(_state, _title, search) {
      location.search = search;
    },
  };
  return clock;
}

/** Seconds since the epoch of a time as 2026-03-29T04:00:00, in UTC. */
export const at = (text) => Date.parse(`${text}Z`) / 1000;
