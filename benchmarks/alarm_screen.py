"""Alarms on the screen: from the last byte of a response to the head of a page among twenty, and the summary
of a line whose journal has a million transitions.
"""

from __future__ import annotations

import sqlite3
import tempfile
import time
from pathlib import Path

from playwright.sync_api import Page

from benchmarks.onlookers import onlookers
from benchmarks.page import viewer_page
from benchmarks.tables import median, milliseconds, quantile, show
from bus.catalogue.values import status_bits
from bus.settings import Dialect
from bus.wire.commands import ReadStatusRequest, StatusReply, parse_reply
from tests.e2e.site import Site, eventually, site

BROWSERS = 20
PRESSES = 60
TRANSITIONS = 1_000_000
OPENINGS = 20
WATCH_WAITING = """() => {
  window.seen = [];
  const node = document.querySelector('[data-live="alarms_present.waiting"]');
  new MutationObserver(() => {
    window.seen.push([(performance.timeOrigin + performance.now()) / 1000, node.textContent]);
  }).observe(node, { characterData: true, childList: true, subtree: true });
}"""
WAITING = "document.querySelector('[data-live=\"alarms_present.waiting\"]').textContent"
OPENED = "performance.getEntriesByType('navigation')[0].domContentLoadedEventEnd"
INSERT = """
INSERT INTO alarm_journal
    (at, alarm, occurrence, code, name, bus, unit, priority, trigger, before, after, who, reason)
VALUES (?, ?, ?, 'estop_active', 'E-stop', 'line', ?, 'urgent', ?, ?, ?, '', '')"""
RISE, CLEAR = ("rise", "normal", "unack_active"), ("clear", "unack_active", "rtn_unack")


def run() -> None:
    """Print one table."""
    with tempfile.TemporaryDirectory() as folder, site(Path(folder), installed=True) as served:
        with viewer_page(served) as page, onlookers(served.url, served.tokens["viewer"], BROWSERS - 1):
            delays = _delays(served, page)
        served.stop()
        fill_journal(Path(folder) / "data" / "lineside.db")
        served.start()
        served.wait_for_units()
        with viewer_page(served) as page:
            openings = _openings(page)
    rows = [
        _row(f"an e-stop in the head of a page, {BROWSERS} browsers", delays),
        _row(f"the summary, {TRANSITIONS:,} transitions in the journal", openings),
    ]
    show("alarms on the screen", ["", "times", "median", "p99"], rows, "At most 100 ms and 300 ms (p99).")


def _row(name: str, seconds: list[float]) -> list[str]:
    return [name, str(len(seconds)), milliseconds(median(seconds)), milliseconds(quantile(seconds, 0.99))]


def _delays(served: Site, page: Page) -> list[float]:
    """From the last byte of the first response with an e-stop to the number of alarms in Chromium."""
    offset = time.time() - time.monotonic()
    page.goto("/")
    page.wait_for_selector("body[data-link=live]")
    page.evaluate(WATCH_WAITING)
    delays = []
    for press in range(PRESSES):
        unit = press % served.units + 1
        since = served.line.remote.do("record", kinds=["sent"])[-1]["number"]
        page.evaluate("window.seen = []")
        served.line.remote.do("input", unit=unit, input="estop", on=True)
        eventually(lambda: page.evaluate("window.seen.length"), "the alarm on the page")
        delays.append(page.evaluate("window.seen[0][0]") - offset - _sent_at(served, unit, since))
        served.line.remote.do("input", unit=unit, input="estop", on=False)
        eventually(lambda: _acknowledged(served), "the alarms gone")
        eventually(lambda: page.evaluate(WAITING) == "", "no alarm on the page")
    return delays


def _sent_at(served: Site, unit: int, since: int) -> float:
    """When the last byte of the first status with an active e-stop was out."""
    is_it = False
    for entry in served.line.remote.do("record", since=since, kinds=["responded", "sent"]):
        if entry["what"] == "responded":
            is_it = entry["unit"] == unit and _has_estop(unit, bytes.fromhex(entry["hex"]))
        elif is_it:
            return float(entry["at"])
    raise AssertionError("no response had the e-stop")


def _has_estop(unit: int, body: bytes) -> bool:
    reply = parse_reply(ReadStatusRequest(unit), body, Dialect())
    return isinstance(reply, StatusReply) and status_bits(reply.outputs, reply.inputs).estop_active


def _acknowledged(served: Site) -> bool:
    """Acknowledge what waits; whether every alarm is normal again."""
    with served.api("operator") as client:
        alarms = client.get("/alarms").json()["alarms"]
        for alarm in alarms:
            if not alarm["acknowledged"]:
                client.post(f"/alarms/{alarm['id']}/acknowledge")
    return not alarms


def fill_journal(store: Path) -> None:
    """A week of transitions of alarms that are no longer configured."""
    with sqlite3.connect(store) as connection:
        now = time.time()
        rows = (
            (
                now - (TRANSITIONS - number) * 0.6,
                f"line.{number % 8 + 1}.filled",
                number // 16 + 1,
                number % 8 + 1,
                *(RISE if number // 8 % 2 else CLEAR),
            )
            for number in range(TRANSITIONS)
        )
        connection.executemany(INSERT, rows)
    connection.close()


def _openings(page: Page) -> list[float]:
    page.goto("/alarms")
    seconds = []
    for _ in range(OPENINGS):
        page.goto("/")
        page.goto("/alarms")
        seconds.append(page.evaluate(OPENED) / 1000)
    return seconds
