"""A flood of alarms: 10,000 changes of 100 e-stops within a minute, while a person types and opens pages."""

from __future__ import annotations

import sqlite3
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from playwright.sync_api import Browser, Page, sync_playwright

from benchmarks.alarm_screen import OPENED, TRANSITIONS, fill_journal
from benchmarks.fed import Feeder, fed_site
from benchmarks.tables import median, milliseconds, quantile, show
from tests.e2e.conftest import CHROMIUM, FLAGS, focus, signed_in
from tests.e2e.site import Site, eventually

UNITS = 100
CHANGES = 10_000
FLOOD_S = 60.0
KEYS = 60
KEY_S = 0.9
"""Between two keys of a field: the last one is pressed before the flood ends."""
OPENING_EVERY = 3
FIELD_HOLDS = 12
"""Digits; after so many the field is emptied."""
WATCH_KEYS = """(field) => {
  window.seen = [];
  let pressed = 0;
  addEventListener('keydown', (event) => { pressed = event.timeStamp; }, true);
  field.addEventListener('input', () => {
    const [at, value] = [pressed, field.value];
    requestAnimationFrame(() => {
      const drawn = new MessageChannel();
      drawn.port1.onmessage = () => window.seen.push([(performance.now() - at) / 1000, value, field.value]);
      drawn.port2.postMessage(0);
    });
  });
}"""
STORED = """
SELECT unit, trigger, occurrence FROM alarm_journal
WHERE code = 'estop_active' AND alarm NOT LIKE '%.filled' ORDER BY id"""


@dataclass(frozen=True)
class TypedKeys:
    """``shown``: what the field showed after each key, and later still; ``delays``: from a key to the next
    frame, in seconds."""

    shown: list[tuple[str, str]]
    delays: list[float]

    def arrived(self, expected: list[str]) -> int:
        """How many are shown as they were typed, in order."""
        pairs = zip(self.shown, expected, strict=False)
        return sum(at_once == later == wanted for (at_once, later), wanted in pairs)


@dataclass(frozen=True)
class FloodResult:
    """``stored``: transitions of e-stops in the journal; ``twice``: of them those that do not follow from the
    one before. Times in seconds."""

    setpoint: TypedKeys
    place: TypedKeys
    openings: list[float]
    keys_s: float
    flood_s: float
    stored: int
    twice: int


def run() -> None:
    """Print one table."""
    with (
        tempfile.TemporaryDirectory() as folder,
        fed_site(Path(folder), UNITS, CHANGES / FLOOD_S / UNITS, fill_journal) as served,
        _chromium() as chromium,
    ):
        found = _flooded(served, chromium)
    rows = [
        _key_row("keys into the field of a setpoint", found.setpoint, _digits()),
        _key_row("keys into the filter of the summary", found.place, _places()),
        ["the summary opened", str(len(found.openings)), *_times(found.openings)],
        ["transitions stored", f"{found.stored:,} of {CHANGES:,}", "", ""],
        ["transitions stored twice", str(found.twice), "", ""],
    ]
    show(
        f"{CHANGES:,} changes of {UNITS} e-stops in {found.flood_s:.0f} s, the journal has {TRANSITIONS:,}",
        ["", "count", "median", "p99"],
        rows,
        f"Keys were pressed for {found.keys_s:.0f} s, on two pages; a third one opened the summary."
        " At most 300 ms for the summary (p99).",
    )


def _key_row(name: str, typed: TypedKeys, expected: list[str]) -> list[str]:
    return [name, f"{typed.arrived(expected)} of {KEYS}", *_times(typed.delays)]


def _times(seconds: list[float]) -> tuple[str, str]:
    return milliseconds(median(seconds)), milliseconds(quantile(seconds, 0.99))


def _digit(number: int) -> str:
    return str(number * 7 % 10)


def _digits() -> list[str]:
    """The text of the setpoint's field after each key."""
    return [
        "".join(_digit(each) for each in range(number - number % FIELD_HOLDS, number + 1))
        for number in range(KEYS)
    ]


def _places() -> list[str]:
    """The choice of the filter after each key: the bus, then its units."""
    return ["line", *(f"line/{unit}" for unit in range(1, KEYS))]


@contextmanager
def _chromium() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield chromium
        chromium.close()


def _flooded(served: Site, chromium: Browser) -> FloodResult:
    session = signed_in(chromium, served, "operator")
    context = chromium.new_context(base_url=served.url, storage_state=session)
    setpoint, place, opened = (context.new_page() for _ in range(3))
    _watch(setpoint, "/units/line/1", "#setpoint")
    _watch(place, "/alarms?priority=urgent", "[name=place]")
    opened.goto("/alarms")
    assert isinstance(served.line, Feeder)
    began = time.monotonic()
    served.line.flood(CHANGES)
    openings = _press_keys(setpoint, place, opened)
    keys_s = time.monotonic() - began
    served.line.wait_for_flood()
    flood_s = time.monotonic() - began
    stored, twice = _stored(served.folder / "data" / "lineside.db")
    return FloodResult(_typed(setpoint), _typed(place), openings, keys_s, flood_s, stored, twice)


def _watch(page: Page, path: str, field: str) -> None:
    page.goto(path)
    page.wait_for_selector("body[data-link=live]")
    focus(page.locator(field))
    page.locator(field).evaluate(WATCH_KEYS)


def _press_keys(setpoint: Page, place: Page, opened: Page) -> list[float]:
    openings, due = [], time.monotonic()
    for number in range(KEYS):
        if number % FIELD_HOLDS == 0:
            setpoint.locator("#setpoint").evaluate("field => { field.value = ''; }")
        setpoint.keyboard.press(_digit(number))
        place.keyboard.press("ArrowDown")
        if number % OPENING_EVERY == 0:
            opened.goto("/")
            opened.goto("/alarms")
            openings.append(opened.evaluate(OPENED) / 1000)
        due += KEY_S
        opened.wait_for_timeout(max(0.0, due - time.monotonic()) * 1000)
    return openings


def _typed(page: Page) -> TypedKeys:
    seen = page.evaluate("window.seen")
    return TypedKeys([(at_once, later) for _, at_once, later in seen], [delay for delay, _, _ in seen])


def _stored(store: Path) -> tuple[int, int]:
    """How many transitions are in the journal once all are, and how many of them repeat one."""

    def rows() -> list[tuple[int, str, int]]:
        with closing(sqlite3.connect(store)) as connection:
            return connection.execute(STORED).fetchall()

    eventually(lambda: len(rows()) >= CHANGES, "all transitions in the journal")
    former: dict[int, tuple[str, int]] = {}
    twice = 0
    for unit, trigger, occurrence in rows():
        before, last = former.get(unit, ("clear", 0))
        wanted = ("clear", last) if before == "rise" else ("rise", last + 1)
        twice += (trigger, occurrence) != wanted
        former[unit] = (trigger, occurrence)
    return len(rows()), twice
