"""A server on clocks of its test: two hours and a quarter of 16 buses, twelve times as fast, to see what
grows; and a clock that is set by a year."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median

import httpx
import pytest

from app.core.database.connection import examining
from app.line.history.series.runs import micros
from app.line.history.status import growth_of_history
from benchmarks.processes import cpu_seconds, memory_mib
from bus.instants import UnixTime
from tests.e2e.site import add_people, command, end, eventually, free_port, unit_tables
from tests.fast_clock import AHEAD, BACK, FastClock

pytestmark = pytest.mark.soak
BUSES, UNITS = 16, 8
RATE = 0.6
"""Readings of a unit in a second: 77 a second of all, as 16 lines at 1200 baud have."""
FACTOR = 12.0
CACHES_MIB = 4.0
"""What the caches of SQLite may still take after the first hour."""
MINUTE, HOUR, DAY = 60.0, 3600.0, 86_400.0
SAMPLE_S = 30.0
PATHS = ("line", "alarms", "events?limit=50", "events.csv", "buses/bus-1/units/1", "sites")
"""What programs read meanwhile."""


@dataclass(frozen=True)
class Sample:
    """A look at the server: ``at``: seconds of the line, ``memory``: MiB; ``history``, ``events``: bytes of
    these stores."""

    at: float
    memory: float
    descriptors: int
    history: int
    events: int


@contextmanager
def served(
    folder: Path, clock: FastClock, count: int = BUSES
) -> Iterator[tuple[int, subprocess.Popen[str], httpx.Client]]:
    """The process id of a server, what feeds its buses, and its API."""
    config, url = folder / "lineside.toml", f"http://127.0.0.1:{free_port()}"
    names = [f"bus-{number}" for number in range(1, count + 1)]
    buses = "".join(
        f'\n[[bus]]\nname = "{name}"\nport = "/dev/lineside-no-{name}"\n{unit_tables(UNITS)}'
        for name in names
    )
    config.write_text(f'[server]\nport = {url.rpartition(":")[2]}\ndata = "data"\n{buses}')
    token = add_people(config)["admin"]
    create = ("token", "create", "--role", "worker")
    lines = [f"{name} {command(config, *create, f'{name}-feeder', '--bus', name).strip()}" for name in names]
    start = (sys.executable, "-m", "tests.fast_clock", clock.argument())
    with ExitStack() as stack:
        log = stack.enter_context((folder / "log").open("wb"))
        server = subprocess.Popen([*start, "serve", str(config)], stdout=log, stderr=log)
        stack.callback(end, server)
        eventually(lambda: _responds(url), "a response of the server", within=60)
        feeding = (*start, "feed", url, str(UNITS), str(RATE))
        feeder = subprocess.Popen(feeding, stdin=subprocess.PIPE, stdout=log, stderr=log, text=True)
        stack.callback(feeder.wait)
        stack.callback(feeder.kill)
        assert feeder.stdin is not None
        feeder.stdin.write("\n".join(lines))
        feeder.stdin.close()
        headers = {"Authorization": f"Bearer {token}"}
        once = httpx.Limits(max_keepalive_connections=0)
        api = httpx.Client(
            base_url=f"{url}/api/v1", headers=headers, timeout=60, trust_env=False, limits=once
        )
        yield server.pid, feeder, stack.enter_context(api)


def _responds(url: str) -> bool:
    with suppress(httpx.HTTPError):
        return httpx.get(f"{url}/healthz", trust_env=False).is_success
    return False


def _is_due(clock: FastClock, at: float) -> bool:
    return clock.elapsed() >= at


def _read(client: httpx.Client, path: str) -> bool:
    """Whether the server responds; on its clock it waits for a slow request less than on others."""
    with suppress(httpx.HTTPError):
        return client.get(f"/{path}").is_success
    return False


def sampled(process: int, at: float, data: Path) -> Sample:
    history, events = ((data / name).stat().st_size for name in ("history.db", "lineside.db"))
    return Sample(at, memory_mib(process), len([*Path(f"/proc/{process}/fd").iterdir()]), history, events)


def test_two_hours_leave_memory_descriptors_and_disk_as_they_should(tmp_path: Path) -> None:
    now = time.time()
    clock = FastClock(FACTOR, time.monotonic(), now - now % HOUR + HOUR)
    data, samples, forecast = tmp_path / "data", list[Sample](), 0.0
    with served(tmp_path, clock) as (process, feeder, client):
        for place in range(int(135 * MINUTE / SAMPLE_S)):
            eventually(partial(_is_due, clock, place * SAMPLE_S), "the next look", within=600)
            eventually(partial(_read, client, PATHS[place % len(PATHS)]), "a response", within=60)
            assert feeder.poll() is None, (tmp_path / "log").read_text()[-2000:]
            samples.append(sampled(process, clock.elapsed(), data))
            if not forecast and clock.elapsed() > 75 * MINUTE:
                forecast = _forecast(data, UnixTime(clock.wall + clock.elapsed()))
        cpu = cpu_seconds(process)
    early, late = (_within(samples, begin, begin + 15) for begin in (60, 120))
    memory = [median(each.memory for each in span) for span in (early, late)]
    descriptors = [max(each.descriptors for each in span) for span in (early, late)]
    disk = [max(each.history for each in span) for span in (early, late)]
    grown = (disk[1] - disk[0]) * DAY / HOUR
    print(f"\nmemory {memory[0]:.1f} → {memory[1]:.1f} MiB; descriptors {descriptors};", end=" ")
    print(f"history {grown / 1e6:.1f} MB a day, forecast {forecast / 1e6:.1f}; CPU {cpu:.0f} s")
    for span in range(0, 135, 15):
        print(span, [f"{each:.1f}" for each in _figures(_within(samples, span, span + 15))])
    stores = [span[-1].history + span[-1].events for span in (early, late)]
    added = (stores[1] - stores[0]) / 2**20
    # Each connection of SQLite keeps pages of its store until it has 2 MB: no leak, and there are few.
    assert memory[1] <= 1.02 * memory[0] + min(added, CACHES_MIB)
    assert descriptors[1] <= descriptors[0]
    assert grown == pytest.approx(forecast, rel=0.25)


def _within(samples: list[Sample], begin: int, until: int) -> list[Sample]:
    return [each for each in samples if begin * MINUTE <= each.at < until * MINUTE]


def _figures(samples: list[Sample]) -> tuple[float, ...]:
    return (
        min(each.memory for each in samples),
        max(each.memory for each in samples),
        max(each.descriptors for each in samples),
        max(each.history for each in samples) / 1e6,
    )


def _forecast(data: Path, now: UnixTime) -> float:
    """Bytes a day of the history, as ``lineside status`` reckons them."""
    with examining(data / "history.db") as connection:
        growth = growth_of_history(connection, micros(now))
    assert growth is not None
    readings, rollups, _ = growth
    return readings + rollups


def test_a_clock_that_is_set_by_a_year_and_back_stops_nothing(tmp_path: Path) -> None:
    """Ahead, back, and back by another year: it is recorded each time, and what was stored is there."""
    clock = FastClock(1.0, time.monotonic(), time.time())
    with served(tmp_path, clock, 1) as (process, feeder, client):
        eventually(partial(_online, client), "units that are online", within=60)
        begun = _units(client)
        for steps, number in enumerate((AHEAD, BACK, BACK, AHEAD), 1):
            os.kill(process, number)
            eventually(partial(_has_steps, client, steps), "the step in the events")
            eventually(partial(_online, client), "units that are online", within=60)
            speed = _speed(client)
            eventually(partial(_is_other, client, speed), "a new reading", within=60)
        assert _units(client) == begun
        assert client.get("/events/proof").json()["broken"] is None
        assert feeder.poll() is None
    log = (tmp_path / "log").read_text()
    assert "Traceback" not in log, log[-4000:]


def _units(client: httpx.Client) -> list[int]:
    return [unit["id"] for bus in client.get("/line").json()["buses"] for unit in bus["units"]]


def _has_steps(client: httpx.Client, count: int) -> bool:
    wanted = {"kind": "clock", "search": "clock of the app", "limit": 100}
    return len(client.get("/events", params=wanted).json()["events"]) >= count


def _speed(client: httpx.Client) -> object:
    return client.get("/buses/bus-1/units/1").json()["actual"]


def _is_other(client: httpx.Client, speed: object) -> bool:
    return _speed(client) != speed


def _online(client: httpx.Client) -> bool:
    buses = client.get("/line").json()["buses"]
    return all(unit["link"] == "online" for bus in buses for unit in bus["units"])
