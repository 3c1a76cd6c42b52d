"""A server without a wire: a feeder replaces its bus worker, and sends more than a wire could carry."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.e2e.site import Line, Site, end, free_port, unit_tables

NO_PORT = "/dev/lineside-no-port"


@contextmanager
def fed_site(folder: Path, units: int, rate: float) -> Iterator[Site]:
    """A served line on which every unit has a new speed ``rate`` times a second."""
    url = f"http://127.0.0.1:{free_port()}"
    feeder = _Feeder()
    made = Site(folder, feeder, url, units, installed=True)
    try:
        made.config.write_text(_configuration(made), encoding="utf-8")
        made.add_people()
        token = made.command("token", "create", "feeder", "--role", "worker", "--bus", "line").strip()
        made.start()
        feeder.start(url, token, units, rate)
        made.wait_for_units()
        yield made
    finally:
        made.close()


class _Feeder(Line):
    """Stands where the site has its line."""

    def __init__(self) -> None:
        self.port = NO_PORT

    def start(self, url: str, token: str, units: int, rate: float) -> None:
        """Begin to feed."""
        command = [sys.executable, "-m", "benchmarks.feeder", url, token, str(units), str(rate)]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "ready\n", "the feeder was not let in"

    def close(self) -> None:
        """No more."""
        if hasattr(self, "process"):
            end(self.process)


def _configuration(made: Site) -> str:
    port = made.url.rpartition(":")[2]
    head = f'[server]\nport = {port}\ndata = "./data"\n\n[[bus]]\nname = "line"\nport = "{NO_PORT}"\n'
    return head + unit_tables(made.units)
