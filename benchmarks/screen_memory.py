"""A page left open: what it keeps after ten minutes of 255 units changing four times a second. Takes eleven
minutes, so it runs only when asked for."""

from __future__ import annotations

import tempfile
from pathlib import Path

from playwright.sync_api import CDPSession, sync_playwright

from benchmarks.fed import fed_site
from benchmarks.tables import show
from tests.e2e.conftest import CHROMIUM, FLAGS, signed_in

MINUTES = 10
UNITS = 255
RATE = 4.0


def run() -> None:
    """One table."""
    with (
        tempfile.TemporaryDirectory() as folder,
        fed_site(Path(folder), UNITS, RATE) as served,
        sync_playwright() as playwright,
    ):
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        session = signed_in(chromium, served, "viewer")
        page = chromium.new_context(base_url=served.url, storage_state=session).new_page()
        page.goto("/")
        page.wait_for_selector("body[data-link=live]")
        devtools = page.context.new_cdp_session(page)
        devtools.send("Performance.enable")
        rows = []
        for minute in range(MINUTES + 1):
            rows.append([f"minute {minute}", *_kept(devtools)])
            page.wait_for_timeout(60_000 if minute < MINUTES else 0)
        chromium.close()
    show(f"A page of {UNITS} units, all changing {RATE:g} times a second", ["", "heap", "nodes"], rows)


def _kept(devtools: CDPSession) -> list[str]:
    devtools.send("HeapProfiler.collectGarbage")
    found = {entry["name"]: entry["value"] for entry in devtools.send("Performance.getMetrics")["metrics"]}
    return [f"{found['JSHeapUsedSize'] / 1e6:.2f} MB", f"{found['Nodes']:.0f}"]
