"""What a browser uses for moving tiles with their curves, at a size that has room for sixteen."""

from __future__ import annotations

import os
from itertools import pairwise
from pathlib import Path

from playwright.sync_api import CDPSession

from app.line.live.screen import FEW_MOVING
from benchmarks.page import fed_page
from benchmarks.processes import cpu_seconds, family
from benchmarks.tables import median, show

UNITS = 16
READINGS_A_SECOND = 38.4
"""What one wire carries at 9600 baud."""
WIDTH, HEIGHT = 1920, 1440
SETTLE_S = 20.0
MEASURED_S = 20.0
TIMES = 3


def run() -> None:
    """One table: at speed, while all ramp, and while so few ramp that each reading is sent by itself."""
    kinds = (UNITS, ""), (UNITS, "ramping"), (FEW_MOVING, "ramping")
    rows = [[f"{units} {what or 'at speed'}", *_used(units, what)] for units, what in kinds]
    header = ["all units", "all processes", "main thread", "layouts a second", "styles a second"]
    title = f"Tiles at {WIDTH} x {HEIGHT}, {READINGS_A_SECOND:.0f} changes a second"
    note = f"Of one core, median of {TIMES}; all processes of Chromium at most 10 % for {UNITS} tiles."
    show(title, header, rows, note)


def _used(units: int, what: str) -> list[str]:
    with fed_page(units, READINGS_A_SECOND / units, what) as (page, devtools):
        page.set_viewport_size({"width": WIDTH, "height": HEIGHT})
        page.wait_for_timeout(SETTLE_S * 1000)
        counts = [_counted(devtools)]
        for _ in range(TIMES):
            page.wait_for_timeout(MEASURED_S * 1000)
            counts.append(_counted(devtools))
    used, busy, layouts, styles = (median(rates) for rates in zip(*_rates(counts), strict=True))
    return [f"{used:.1%}", f"{busy:.1%}", f"{layouts:.0f}", f"{styles:.0f}"]


def _counted(devtools: CDPSession) -> tuple[float, ...]:
    """(s, CPU s of Chromium, s of its main thread, layouts, style recalculations) so far."""
    found = {entry["name"]: entry["value"] for entry in devtools.send("Performance.getMetrics")["metrics"]}
    used = cpu_seconds(*(process for process in family(os.getpid()) if _is_chromium(process)))
    return found["Timestamp"], used, found["TaskDuration"], found["LayoutCount"], found["RecalcStyleCount"]


def _rates(counts: list[tuple[float, ...]]) -> list[list[float]]:
    """Everything counted in a second, for each time between two counts."""
    pairs = pairwise(counts)
    return [
        [(b - a) / (after[0] - before[0]) for a, b in zip(before[1:], after[1:], strict=True)]
        for before, after in pairs
    ]


def _is_chromium(process: int) -> bool:
    return b"chromium" in Path(f"/proc/{process}/cmdline").read_bytes().split(b"\0")[0]
