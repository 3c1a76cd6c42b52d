"""Memory of a page left open for ten minutes with 255 units changing four times a second. Takes eleven
minutes, so it runs only when named.
"""

from __future__ import annotations

from playwright.sync_api import CDPSession

from benchmarks.page import fed_page
from benchmarks.tables import show

MINUTES = 10
UNITS = 255
RATE = 4.0


def run() -> None:
    """One table."""
    with fed_page(UNITS, RATE) as (page, devtools):
        rows = []
        for minute in range(MINUTES + 1):
            rows.append([f"minute {minute}", *_kept(devtools)])
            page.wait_for_timeout(60_000 if minute < MINUTES else 0)
    show(f"A page of {UNITS} units, all changing {RATE:g} times a second", ["", "heap", "nodes"], rows)


def _kept(devtools: CDPSession) -> list[str]:
    devtools.send("HeapProfiler.collectGarbage")
    found = {entry["name"]: entry["value"] for entry in devtools.send("Performance.getMetrics")["metrics"]}
    return [f"{found['JSHeapUsedSize'] / 1e6:.2f} MB", f"{found['Nodes']:.0f}"]
