"""A server without a wire: a feeder replaces its bus worker, and sends more than a wire could carry."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.e2e.site import Line, Site, end, free_port, unit_tables

NO_PORT = "/dev/lineside-no-port"


@contextmanager
def fed_site(
    folder: Path,
    units: int,
    rate: float,
    before_start: Callable[[Path], None] = lambda _: None,
    what: str = "",
) -> Iterator[Site]:
    """A served line on which every unit has a new speed ``rate`` times a second. ``before_start`` gets the
    store; ``what``: "ramping" or, at speed, empty."""
    url = f"http://127.0.0.1:{free_port()}"
    feeder = Feeder()
    made = Site(folder, feeder, url, units, installed=True)
    try:
        made.config.write_text(_configuration(made), encoding="utf-8")
        made.add_people()
        token = made.command("token", "create", "feeder", "--role", "worker", "--bus", "line").strip()
        before_start(folder / "data" / "lineside.db")
        made.start()
        feeder.start(url, token, units, rate, what)
        made.wait_for_units()
        yield made
    finally:
        made.close()


class Feeder(Line):
    """Stands where the site has its line."""

    def __init__(self) -> None:
        self.port = NO_PORT

    def start(self, url: str, token: str, units: int, rate: float, what: str) -> None:
        """Begin to feed."""
        command = [sys.executable, "-m", "benchmarks.feeder", url, token, str(units), str(rate), what]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "ready\n", "the feeder was not let in"

    def flood(self, changes: int) -> None:
        """Begin to change e-stops, one with each reading."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{changes}\n")

    def wait_for_flood(self) -> None:
        """Until the last of the changes is sent."""
        assert self.process.stdout is not None
        while (line := self.process.stdout.readline()) != "flooded\n":
            assert line == "ready\n", "the feeder ended before its flood"

    def close(self) -> None:
        """No more."""
        if hasattr(self, "process"):
            end(self.process)
            assert self.process.stdin is not None
            self.process.stdin.close()


def _configuration(made: Site) -> str:
    port = made.url.rpartition(":")[2]
    head = f'[server]\nport = {port}\ndata = "./data"\n\n[[bus]]\nname = "line"\nport = "{NO_PORT}"\n'
    return head + unit_tables(made.units)
