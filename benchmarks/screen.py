"""The screen: from the last byte of an answer to the changed text in Chromium, alone and among many."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from playwright.sync_api import Page, sync_playwright

from benchmarks.processes import cpu_seconds, family, memory_mib
from benchmarks.tables import median, milliseconds, quantile, show
from tests.e2e.conftest import CHROMIUM, FLAGS, signed_in
from tests.e2e.site import Site, end, site

MEASURED_S = 15.0
CROWDS = (1, 20, 200)
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
    """Two tables."""
    with (
        tempfile.TemporaryDirectory() as folder,
        site(Path(folder), 8, line_options=("--no-script",)) as served,
        sync_playwright() as playwright,
    ):
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = chromium.new_context(
            base_url=served.url, storage_state=signed_in(chromium, served, "viewer")
        ).new_page()
        _show_weight(page)
        _show_crowds(served, page)
        chromium.close()


def _show_weight(page: Page) -> None:
    answers: list[Any] = []
    page.on("requestfinished", lambda request: answers.append(request))
    page.goto("/", wait_until="networkidle")
    sizes = [request.sizes() for request in answers]
    on_the_way = sum(size["responseBodySize"] + size["responseHeadersSize"] for size in sizes)
    rows = [["the line page, first visit", len(sizes), f"{on_the_way / 1024:.0f} KiB"]]
    show("What a page weighs", ["", "requests", "on the way"], rows)


def _show_crowds(served: Site, page: Page) -> None:
    assert served.server is not None
    processes = family(served.server.pid)
    rows = []
    for browsers in CROWDS:
        with _onlookers(served, browsers - 1):
            page.goto("/")
            page.wait_for_selector("body[data-link=live]")
            delays, cpu = _delays(served, page, processes)
            memory = memory_mib(*processes)
        times = [milliseconds(median(delays)), milliseconds(quantile(delays, 0.99))]
        rows.append([str(browsers), str(len(delays)), *times, f"{cpu:.1%}", f"{memory:.0f} MiB"])
    header = ["browsers", "changes", "median", "p99", "CPU of one core", "memory"]
    note = "CPU and memory: server and bus worker together. " + NODE_RED
    show("An answer's last byte → changed text in Chromium", header, rows, note)


def _delays(served: Site, page: Page, processes: list[int]) -> tuple[list[float], float]:
    """The delay of every change of an actual speed while all units ramp, and the server's CPU share."""
    monotonic_to_epoch = time.time() - time.monotonic()
    since = served.line.remote.do("record", kinds=["sent"])[-1]["number"]
    _ramp(served)
    page.evaluate(WATCH_TEXTS)
    begun, used = time.monotonic(), cpu_seconds(*processes)
    page.wait_for_timeout(MEASURED_S * 1000)
    cpu = (cpu_seconds(*processes) - used) / (time.monotonic() - begun)
    sent = _sent(served, since, monotonic_to_epoch)
    delays = [
        _delay(sent.get(unit, []), at, _digits(text)) for at, unit, text in page.evaluate("window.seen")
    ]
    return [delay for delay in delays if delay is not None], cpu


def _ramp(served: Site) -> None:
    """To the other end of the scale, so that every answer says something new."""
    high = served.unit(1)["commanded_raw"] < 500
    setpoints = {str(unit): {"raw": 1900 if high else 50} for unit in range(1, served.units + 1)}
    with served.api("operator") as client:
        client.post("/buses/line/speeds", json={"setpoints": setpoints, "timeout_s": 20}).raise_for_status()


def _sent(served: Site, since: int, offset: float) -> dict[int, list[tuple[float, int]]]:
    """For each unit the times (epoch) at which its status answers were out, and the actual speed in them."""
    found: dict[int, list[tuple[float, int]]] = {}
    said: tuple[int, int] | None = None
    for entry in served.line.remote.do("record", since=since, kinds=["said", "sent"]):
        data = bytes.fromhex(entry["hex"])
        if entry["what"] == "said":
            said = (entry["unit"], int.from_bytes(data[6:10])) if len(data) > 10 else None
        elif said is not None:
            found.setdefault(said[0], []).append((entry["at"] + offset, said[1]))
            said = None
    return found


def _delay(sent: list[tuple[float, int]], at: float, actual: int | None) -> float | None:
    """Since the answer that brought this text: the last before it with that value."""
    times = [out for out, value in sent if out <= at and value == actual]
    return at - times[-1] if times else None


def _digits(text: str) -> int | None:
    digits = "".join(letter for letter in text if letter.isdecimal())
    return int(digits) if digits else None


@contextmanager
def _onlookers(served: Site, count: int) -> Iterator[None]:
    if not count:
        yield
        return
    arguments = [served.url, served.tokens["viewer"], str(count)]
    process = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.onlookers", *arguments], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n", "the onlookers were not let in"
        yield
    finally:
        end(process)
