"""A backup: its share of the wire without and with an open page."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.tables import show
from bus.settings import BITS_PER_BYTE
from tests.e2e.site import LINESIDE, Site, site

BAUD = 9600
UNITS = 32
WATCHED_UNITS = 8
CALM_S = 8.0
POLL, READ = "81", "85"


def run() -> None:
    """Print one table: 32 units without an open page; 8 with one."""
    rows = []
    with _line(UNITS) as served:
        _, took, least = _back_up(served)
        rows.append([f"{UNITS} units, no open page", f"{took:.1f} s", f"{took / least:.3f}", ""])
    with _line(WATCHED_UNITS) as served, _open_page(served):
        calm = _polls_a_second(served, CALM_S)
        polls, took, least = _back_up(served)
        kept = polls / took / calm
        rows.append(
            [f"{WATCHED_UNITS} units, watched", f"{took:.1f} s", f"{took / least:.3f}", f"{kept:.2f}"]
        )
    note = "Its frames: every 85h and its response."
    show("lineside backup", ["", "took", "÷ wire time of its frames", "the scan keeps"], rows, note)


@contextmanager
def _line(units: int) -> Iterator[Site]:
    with (
        tempfile.TemporaryDirectory() as folder,
        site(Path(folder), units, line_options=("--no-script",), installed=True) as served,
    ):
        time.sleep(CALM_S)
        yield served


@contextmanager
def _open_page(served: Site) -> Iterator[None]:
    command = [sys.executable, "-m", "benchmarks.onlookers", served.url, served.tokens["viewer"], "1"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline().strip() == "ready"
    try:
        yield
    finally:
        process.terminate()
        process.wait()
        process.stdout.close()


def _back_up(served: Site) -> tuple[int, float, float]:
    """Return the polls meanwhile, the seconds from the first 85h to the last response, and the wire time of
    its frames.
    """
    since = _record(served, 0)[-1]["number"]
    out = served.folder / "backup.toml"
    command = [LINESIDE, "backup", "--url", served.url, "--token", served.tokens["engineer"], "--bus", "line"]
    subprocess.run([*command, "--out", str(out)], check=True, capture_output=True)
    frames = _record(served, since)
    reads = [place for place, frame in enumerate(frames) if _is(frame, READ)]
    span = frames[reads[0] : reads[-1] + 2]
    octets = sum(_octets(frames[place]) + _octets(frames[place + 1]) for place in reads)
    polls = sum(_is(frame, POLL) for frame in span)
    return polls, span[-1]["at"] - span[0]["at"], octets * BITS_PER_BYTE / BAUD


def _polls_a_second(served: Site, seconds: float) -> float:
    since = _record(served, 0)[-1]["number"]
    time.sleep(seconds)
    return sum(_is(frame, POLL) for frame in _record(served, since)) / seconds


def _record(served: Site, since: int) -> list[dict[str, Any]]:
    """Return requests and responses in the order of time."""
    found: list[dict[str, Any]] = served.line.remote.do("record", since=since, kinds=["came", "sent"])
    return sorted(found, key=lambda frame: float(frame["at"]))


def _is(frame: dict[str, Any], command: str) -> bool:
    return frame["what"] == "came" and command in frame["hex"].split()[3:5]


def _octets(frame: dict[str, Any]) -> int:
    return len(frame["hex"].split())
