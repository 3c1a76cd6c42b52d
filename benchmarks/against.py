"""This tree beside an earlier commit, in turns within one run: ``python -m benchmarks against COMMIT``.

Both run on the packages of this environment. Work is judged by the CPU time that it takes the server, which
other programs on the machine change less than they change latencies.
"""

from __future__ import annotations

import asyncio
import json
import subprocess
import time
from collections import defaultdict
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import httpx
from websockets.asyncio.client import connect

from benchmarks.onlookers import onlookers
from benchmarks.processes import cpu_seconds, family, memory_mib
from benchmarks.revision import (
    NO_PORT,
    TREE,
    Revision,
    Served,
    Store,
    exported,
    prepared,
    wait_until_served,
)
from benchmarks.tables import median, quantile, show
from tests.e2e.site import end, start_line

REPEATS = 3
READINGS_A_SECOND = 38.4
"""What one wire carries at 9600 baud."""
UNITS = 8
GROWTH = (32, 255)
CROWDS = (20, 200)
SETTLE_S = 3.0
MEASURED_S = 8.0
COMMANDS = 60
PAUSE_S = 0.037
"""Between two commands; no multiple of a poll, so that they fall anywhere in one."""
FIELDS = "line/1"
Figures = Mapping[str, float]
"""By a name that ends with the measure."""


def run(commit: str) -> None:
    """Print one table."""
    found: tuple[defaultdict[str, list[float]], ...] = (defaultdict(list), defaultdict(list))
    with exported(commit) as former, prepared(former) as before, prepared(Revision("this", TREE)) as now:
        trees = list(zip((before, now), found, strict=True))
        for turn in range(REPEATS):
            for store, figures in trees if turn % 2 else reversed(trees):
                for name, figure in _figures(store).items():
                    figures[name].append(figure)
    old, new = ({name: median(each) for name, each in figures.items()} for figures in found)
    rows = [[name, f"{old[name]:.4g}", f"{new[name]:.4g}", f"{new[name] / old[name]:.2f}"] for name in old]
    note = (
        f"Medians of {REPEATS}, the trees in turns; CPU and memory are of the app, without its workers. "
        "The CPU of a command includes that of the readings until the next one: more on a loaded machine."
    )
    show(f"This tree against {commit}", ["", commit, "this", "ratio"], rows, note)


def _figures(store: Store) -> Figures:
    found = dict(_of_start(store))
    for units in GROWTH:
        found |= _of_crowds(store, units)
    return found


# --- the start, and commands -----------------------------------------------------------------------


def _of_start(store: Store) -> Iterator[tuple[str, float]]:
    with TemporaryDirectory() as folder, _line(folder) as port, store.served(UNITS, port) as server:
        begun = time.monotonic()
        asyncio.run(_first_value(server))
        yield "first live value, s", time.monotonic() - begun
        yield "app until then, CPU s", cpu_seconds(server.process.pid)
        yield from _of_commands(server, "first commands")
        time.sleep(SETTLE_S)
        yield from _of_commands(server, "later commands")
        server.get("/")
        yield f"memory, {UNITS} units, MiB", memory_mib(server.process.pid)
        yield "memory of a worker, MiB", memory_mib(*family(server.process.pid)[1:])


@contextmanager
def _line(folder: str) -> Iterator[str]:
    line = start_line(Path(folder), UNITS, "--no-script")
    try:
        yield line.port
    finally:
        line.close()


async def _first_value(server: Served) -> None:
    while True:
        with suppress(OSError, TimeoutError):
            async for fields in _fields(server):
                if any(letter.isdecimal() for letter in fields.get("actual", "")):
                    return
        await asyncio.sleep(0.02)


async def _fields(server: Served) -> AsyncIterator[Mapping[str, str]]:
    """What an open page is sent of the first unit."""
    headers = {"Authorization": f"Bearer {server.tokens['viewer']}", "Origin": server.url}
    address = server.url.replace("http", "ws", 1) + "/live?language=en"
    async with connect(address, additional_headers=headers, compression=None, max_size=None) as socket:
        await socket.send(json.dumps({"trace": ""}))
        async for message in socket:
            yield json.loads(message)["f"].get(FIELDS, {})


def _of_commands(server: Served, name: str) -> Iterator[tuple[str, float]]:
    headers = {"Authorization": f"Bearer {server.tokens['operator']}"}
    used, seconds = cpu_seconds(server.process.pid), []
    with httpx.Client(
        base_url=f"{server.url}/api/v1", headers=headers, timeout=30, trust_env=False
    ) as client:
        for number in range(COMMANDS):
            begun = time.monotonic()
            body = {"raw": 1100 + number, "execute": True}
            client.post(f"/buses/line/units/{number % UNITS + 1}/speed", json=body).raise_for_status()
            seconds.append(time.monotonic() - begun)
            time.sleep(PAUSE_S)
    yield f"{name}, p99 ms", 1000 * quantile(seconds, 0.99)
    yield f"{name}, CPU ms each", 1000 * (cpu_seconds(server.process.pid) - used) / COMMANDS


# --- many units, many browsers ------------------------------------------------------------------------


def _of_crowds(store: Store, units: int) -> Iterator[tuple[str, float]]:
    with store.served(units, NO_PORT) as server, _fed(server, units):
        server.get("/")
        alone = 0.0
        for browsers in (1, *CROWDS):
            with onlookers(server.url, server.tokens["viewer"], browsers):
                time.sleep(SETTLE_S)
                used, begun = cpu_seconds(server.process.pid), time.monotonic()
                time.sleep(MEASURED_S)
                share = (cpu_seconds(server.process.pid) - used) / (time.monotonic() - begun)
                memory = memory_mib(server.process.pid)
            alone = alone or memory
            yield f"{units} units, {browsers} browsers, CPU %", 100 * share
            if browsers > 1:
                more = (memory - alone) * 1024 / (browsers - 1)
                yield f"{units} units, {browsers} browsers, KiB each", more
        yield f"memory, {units} units, MiB", alone


@contextmanager
def _fed(server: Served, units: int) -> Iterator[None]:
    """Feed as many readings as a wire brings, by the feeder of the revision, which speaks its contract."""
    wait_until_served(server)
    arguments = (server.url, server.tokens["worker"], str(units), str(READINGS_A_SECOND / units))
    called = server.revision.called("benchmarks.feeder", *arguments)
    process = subprocess.Popen(
        called,
        cwd=server.revision.folder,
        env=server.revision.environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n", "the feeder was not let in"
        yield
    finally:
        end(process)
