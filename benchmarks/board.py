"""The board: what every unit's changing four times a second costs a page on a device four times as slow."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

from playwright.sync_api import CDPSession, Page, sync_playwright

from benchmarks.fed import fed_site
from benchmarks.tables import show
from tests.e2e.conftest import CHROMIUM, FLAGS, signed_in

SLOWED = 4
RATE = 4.0
SETTLE_S = 4.0
MEASURED_S = 12.0
PRESSES = 60
GROWTH = (8, 32, 255)
OBSERVE = """() => {
  window.changes = 0;
  window.presses = [];
  window.shifted = 0;
  for (const node of document.querySelectorAll('[data-live$=".actual"]'))
    new MutationObserver(() => window.changes++).observe(node, { characterData: true, subtree: true });
  addEventListener('keydown', (event) => window.presses.push(performance.now() - event.timeStamp), true);
  new PerformanceObserver((list) => {
    for (const entry of list.getEntries()) window.shifted += entry.value;
  }).observe({ type: 'layout-shift' });
}"""


@dataclass(frozen=True)
class Cost:
    """``share`` of the main thread; ``rate`` at which each text changed; delays of keys in milliseconds."""

    share: float
    rate: float
    delays: list[float]
    shifted: float


def run() -> None:
    """One table."""
    rows = [_row(units) for units in GROWTH]
    header = ["units", "main thread", "changes of each a second", "keys seen", "longest wait", "layout shift"]
    title = f"Every unit changing {RATE:g} times a second, Chromium slowed {SLOWED} times"
    show(title, header, rows, "The machine must have nothing else to do: the share is of time, not of work.")


def _row(units: int) -> list[str]:
    with (
        tempfile.TemporaryDirectory() as folder,
        fed_site(Path(folder), units, RATE) as served,
        sync_playwright() as playwright,
    ):
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        session = signed_in(chromium, served, "viewer")
        cost = _cost(chromium.new_context(base_url=served.url, storage_state=session).new_page(), units)
        chromium.close()
    waited = f"{max(cost.delays, default=0):.0f} ms"
    keys = f"{len(cost.delays)} of {PRESSES}"
    return [str(units), f"{cost.share:.0%}", f"{cost.rate:.1f}", keys, waited, f"{cost.shifted:.4f}"]


def _cost(page: Page, units: int) -> Cost:
    page.goto("/")
    page.wait_for_selector("body[data-link=live]")
    devtools = page.context.new_cdp_session(page)
    devtools.send("Performance.enable")
    devtools.send("Emulation.setCPUThrottlingRate", {"rate": SLOWED})
    page.wait_for_timeout(SETTLE_S * 1000)
    page.evaluate(OBSERVE)
    before, begun, changes = *_tasks(devtools), page.evaluate("window.changes")
    for _ in range(PRESSES):
        page.keyboard.press("Shift")
        page.wait_for_timeout(MEASURED_S * 1000 / PRESSES)
    after, ended = _tasks(devtools)
    seconds = ended - begun
    rate = (page.evaluate("window.changes") - changes) / seconds / units
    return Cost(
        (after - before) / seconds, rate, page.evaluate("window.presses"), page.evaluate("window.shifted")
    )


def _tasks(devtools: CDPSession) -> tuple[float, float]:
    """Seconds that the main thread was busy so far, and the time."""
    found = {entry["name"]: entry["value"] for entry in devtools.send("Performance.getMetrics")["metrics"]}
    return found["TaskDuration"], found["Timestamp"]
