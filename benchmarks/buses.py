"""What a bus worker costs of the machine, alone and beside others."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from benchmarks.processes import cpu_seconds, family, memory_mib
from benchmarks.tables import show
from tests.e2e.site import Site, site

UNITS = 8
COUNTS = (1, 4, 16)
SETTLING_S = 25.0
"""Until the parameters that are needed to show the units right have been read."""
MEASURED_S = 20.0


def run() -> None:
    """One table."""
    header = ["buses", "polls/s of each", "CPU of a worker", "the busiest", "CPU of the server", "its memory"]
    note = (
        f"{UNITS} units a bus, 9600 baud, paced. CPU: of one core. Must reach 3 % for one worker.\n"
        "  The simulated lines run on the same machine, one process each, and take their part of it."
    )
    rows = [[str(count), *_row(count)] for count in COUNTS]
    show("What workers cost", [*header, "memory of a worker"], rows, note)


def _row(count: int) -> list[str]:
    more = {f"line-{number}": UNITS for number in range(2, count + 1)}
    with tempfile.TemporaryDirectory() as folder:
        try:
            with site(Path(folder), UNITS, line_options=("--no-script",), more=more) as served:
                return _measure(served, count)
        except AssertionError:
            return ["not served in a minute", "", "", "", "", ""]


def _measure(served: Site, count: int) -> list[str]:
    assert served.server is not None
    time.sleep(SETTLING_S)
    server, *workers = family(served.server.pid)
    begun, polls = time.monotonic(), polled(served)
    used = {process: cpu_seconds(process) for process in (server, *workers)}
    time.sleep(MEASURED_S)
    seconds = time.monotonic() - begun
    rate = (polled(served) - polls) / seconds / count
    cpu = {process: (cpu_seconds(process) - used[process]) / seconds for process in used}
    each = [cpu[worker] for worker in workers]
    return [
        f"{rate:.1f}",
        f"{sum(each) / len(each):.2%}",
        f"{max(each):.2%}",
        f"{cpu[server]:.2%}",
        f"{memory_mib(server):.0f} MiB",
        f"{memory_mib(*workers) / len(workers):.0f} MiB",
    ]


def polled(served: Site) -> float:
    """Polls so far, of all units of all buses."""
    with served.api("viewer") as client:
        text = client.get(f"{served.url}/metrics").text.splitlines()
    return sum(float(row.split()[-1]) for row in text if row.startswith("lineside_polls_total{"))
