"""The board: what every unit's changing four times a second costs a page on a device four times as slow."""

from __future__ import annotations

from dataclasses import dataclass

from playwright.sync_api import CDPSession, Page

from benchmarks.page import fed_page
from benchmarks.tables import show

SLOWED = 4
RATE = 4.0
SETTLE_S = 4.0
MEASURED_S = 60.0
PRESSES = 60
GROWTH = (8, 32, 255)
OBSERVE = """() => {
  window.changes = [0, 0];
  window.texts = [0, 0];
  window.presses = [];
  window.shifted = 0;
  for (const node of document.querySelectorAll('[data-live$=".actual"]')) {
    const box = node.getBoundingClientRect();
    const away = Number(box.bottom <= 0 || box.top >= innerHeight);
    window.texts[away] += 1;
    new MutationObserver(() => { window.changes[away] += 1; })
      .observe(node, { characterData: true, subtree: true });
  }
  addEventListener('keydown', (event) => window.presses.push(performance.now() - event.timeStamp), true);
  new PerformanceObserver((list) => {
    for (const entry of list.getEntries()) window.shifted += entry.value;
  }).observe({ type: 'layout-shift' });
}"""


@dataclass(frozen=True)
class Cost:
    """``share`` of the main thread; ``rates`` at which each text in the window and each
    scrolled away changed, with how many there were; delays of keys in milliseconds."""

    share: float
    rates: list[tuple[int, float]]
    delays: list[float]
    shifted: float


def run() -> None:
    """One table."""
    rows = [_row(units) for units in GROWTH]
    header = [
        "units",
        "main thread",
        "changes a second of each visible unit",
        "of each scrolled away",
        "keys seen",
        "longest wait",
        "layout shift",
    ]
    title = f"Every unit changing {RATE:g} times a second, Chromium slowed {SLOWED} times"
    show(title, header, rows, "The machine must have nothing else to do: the share is of time, not of work.")


def _row(units: int) -> list[str]:
    with fed_page(units, RATE) as (page, devtools):
        cost = _cost(page, devtools)
    waited = f"{max(cost.delays, default=0):.0f} ms"
    keys = f"{len(cost.delays)} of {PRESSES}"
    rates = [f"{rate:.1f} ({count})" if count else "" for count, rate in cost.rates]
    return [str(units), f"{cost.share:.0%}", *rates, keys, waited, f"{cost.shifted:.4f}"]


def _cost(page: Page, devtools: CDPSession) -> Cost:
    devtools.send("Emulation.setCPUThrottlingRate", {"rate": SLOWED})
    page.wait_for_timeout(SETTLE_S * 1000)
    page.evaluate(OBSERVE)
    before, begun = _tasks(devtools)
    for _ in range(PRESSES):
        page.keyboard.press("Shift")
        page.wait_for_timeout(MEASURED_S * 1000 / PRESSES)
    after, ended = _tasks(devtools)
    seconds = ended - begun
    counted = zip(page.evaluate("window.texts"), page.evaluate("window.changes"), strict=True)
    rates = [(texts, changes / seconds / max(texts, 1)) for texts, changes in counted]
    return Cost(
        (after - before) / seconds, rates, page.evaluate("window.presses"), page.evaluate("window.shifted")
    )


def _tasks(devtools: CDPSession) -> tuple[float, float]:
    """Seconds that the main thread was busy so far, and the time."""
    found = {entry["name"]: entry["value"] for entry in devtools.send("Performance.getMetrics")["metrics"]}
    return found["TaskDuration"], found["Timestamp"]
