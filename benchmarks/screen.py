"""The screen: from the last byte of a response to the changed text in Chromium, alone and among many."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from playwright.sync_api import Page

from app.line.live.requests import MAX_PAGES_OF_ACCOUNT
from app.line.live.screen import FEW_MOVING
from benchmarks.first_visit import show_first_visit
from benchmarks.onlookers import onlookers
from benchmarks.page import viewer_page
from benchmarks.processes import cpu_seconds, family, memory_mib
from benchmarks.tables import median, milliseconds, quantile, show
from tests.e2e.site import Site, site

MEASURED_S = 12.0
CROWDS = (1, 20, 200, 500)
UNITS = 8
GROWTH = (32, 255)
GROWTH_CROWDS = (20, 200)
WATCH_TEXTS = """() => {
  window.seen = [];
  for (const node of document.querySelectorAll('[data-live$=".actual"]')) {
    const unit = Number(node.dataset.live.split('/')[1].split('.')[0]);
    new MutationObserver(() => {
      window.seen.push([(performance.timeOrigin + performance.now()) / 1000, unit, node.textContent]);
    }).observe(node, { characterData: true, childList: true, subtree: true });
  }
}"""
NODE_RED = "Node-RED 4.1 with Dashboard 2, measured before: 1.8 / 6 ms, with 20 browsers 2.6 / 14 ms."


def run() -> None:
    """What a first visit costs, then how the way to the screen grows with the browsers and with the units."""
    rows: list[list[str]] = []
    for units in (UNITS, *GROWTH):
        with (
            tempfile.TemporaryDirectory() as folder,
            site(Path(folder), units, line_options=("--no-script",), installed=True) as served,
            viewer_page(served) as page,
        ):
            if units == UNITS:
                assert page.context.browser is not None
                show_first_visit(served, page.context.browser)
            rows += _crowds(served, page, CROWDS if units == UNITS else GROWTH_CROWDS)
    header = ["units, browsers", "changes", "median", "p99", "server", "worker", "memory", "a browser more"]
    note = f"CPU of one core, memory of both. Speeds of more than {FEW_MOVING} units go together. {NODE_RED}"
    show("A response's last byte → changed text in Chromium", header, rows, note)


def _crowds(served: Site, page: Page, crowds: Iterable[int]) -> Iterator[list[str]]:
    assert served.server is not None
    server, *workers = family(served.server.pid)
    alone = 0.0
    for browsers in crowds:
        with _onlookers(served, browsers - 1):
            page.goto("/")
            page.wait_for_selector("body[data-link=live]")
            delays, shares = _delays(served, page, [[server], workers])
            memory = memory_mib(server, *workers)
        alone = alone or memory
        more = f"{(memory - alone) * 1024 / (browsers - 1):.0f} KiB" if browsers > 20 else ""
        times = [milliseconds(median(delays)), milliseconds(quantile(delays, 0.99))]
        used = [f"{share:.1%}" for share in shares]
        yield [f"{served.units}, {browsers}", str(len(delays)), *times, *used, f"{memory:.0f} MiB", more]


def _delays(served: Site, page: Page, groups: list[list[int]]) -> tuple[list[float], list[float]]:
    """The delay of every change of an actual speed while all units ramp, and the CPU share of each group of
    processes."""
    monotonic_to_epoch = time.time() - time.monotonic()
    since = served.line.remote.do("record", kinds=["sent"])[-1]["number"]
    ramp(served)
    page.evaluate(WATCH_TEXTS)
    begun, used = time.monotonic(), [cpu_seconds(*group) for group in groups]
    page.wait_for_timeout(MEASURED_S * 1000)
    seconds = time.monotonic() - begun
    shares = [(cpu_seconds(*group) - past) / seconds for group, past in zip(groups, used, strict=True)]
    sent = _sent(served, since, monotonic_to_epoch)
    delays = [
        _delay(sent.get(unit, []), at, _digits(text)) for at, unit, text in page.evaluate("window.seen")
    ]
    return [delay for delay in delays if delay is not None], shares


def ramp(served: Site) -> None:
    """Ramp to the other end of the scale, so that every response has a new value."""
    with served.api("operator") as client:
        units = client.get("/line").json()["buses"][0]["units"]
        # Followers take a ratio, and come along with their master.
        masters = {str(unit["id"]): unit["commanded_raw"] for unit in units if not unit["inputs"]["slave"]}
        raw = 1900 if min(masters.values()) < 500 else 50
        setpoints = {unit: {"raw": raw} for unit in masters}
        client.post("/buses/line/speeds", json={"setpoints": setpoints, "timeout_s": 30}).raise_for_status()


def _sent(served: Site, since: int, offset: float) -> dict[int, list[tuple[float, int]]]:
    """Return for each unit the times (epoch) at which its status responses were out, with their actual
    speeds.
    """
    found: dict[int, list[tuple[float, int]]] = {}
    responded: tuple[int, int] | None = None
    for entry in served.line.remote.do("record", since=since, kinds=["responded", "sent"]):
        data = bytes.fromhex(entry["hex"])
        if entry["what"] == "responded":
            responded = (entry["unit"], int.from_bytes(data[6:10])) if len(data) > 10 else None
        elif responded is not None:
            found.setdefault(responded[0], []).append((entry["at"] + offset, responded[1]))
            responded = None
    return found


def _delay(sent: list[tuple[float, int]], at: float, actual: int | None) -> float | None:
    """Return the time since the response that brought this text: the last before it with that value."""
    times = [out for out, value in sent if out <= at and value == actual]
    return at - times[-1] if times else None


def _digits(text: str) -> int | None:
    digits = "".join(letter for letter in text if letter.isdecimal())
    return int(digits) if digits else None


@contextmanager
def _onlookers(served: Site, count: int) -> Iterator[None]:
    """Pages of as many accounts as it takes: each may have MAX_PAGES_OF_ACCOUNT open."""
    with ExitStack() as open_pages:
        for token, first in zip(served.tokens.values(), range(0, count, MAX_PAGES_OF_ACCOUNT), strict=False):
            number = min(MAX_PAGES_OF_ACCOUNT, count - first)
            open_pages.enter_context(onlookers(served.url, token, number))
        yield
