"""The app was away for ten minutes of a full bus: every reading is in the history, at its own time."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from shutil import copytree
from typing import Any

import httpx

from bus import contract
from bus.contract import CONTRACT_VERSION, BusLink, Hello, Reading, Snapshot, Watch
from bus.contract.session import ClockOffset
from bus.worker.outbox import Outbox
from bus.worker.uplink import Uplink
from tests import fork_server
from tests.e2e.limits import PROCEDURE_S
from tests.e2e.site import command, end, eventually, people
from tests.free_port import free_port

UNITS = (1, 2, 3, 4)
AWAY_S = 600
EACH_S = 25 * 10 / 9600
"""A poll and its response at 9600 baud."""


class Polling:
    """A worker with a simulated line, and a real buffer and link."""

    def __init__(self) -> None:
        self.since = time.time() - AWAY_S
        self.app_clock = ClockOffset()

    def hello(self) -> Hello:
        """Who speaks."""
        return Hello(
            version=CONTRACT_VERSION,
            bus="far",
            worker="of the test",
            started_at=self.since,
            software="test",
            port="/dev/elsewhere",
            sent_at=time.time(),
        )

    def note_held(self, units: Sequence[int]) -> None:
        """No unit holds a staged speed."""

    def snapshot(self, seq: int) -> Snapshot:
        """The port is open."""
        return Snapshot(
            seq=seq,
            sent_at=time.time(),
            bus=BusLink(self.since, "open", baud=9600),
            units=[],
            app_behind_s=self.app_clock.seconds,
        )

    def command(self, command: contract.Command) -> None:
        """Unused."""

    def reserve(self) -> None:
        """Unused."""

    def cancel(self, command_id: str) -> None:
        """Unused."""

    def watch(self, watch: Watch) -> None:
        """Whatever people look at."""


def ten_minutes(since: float) -> list[Reading]:
    """Of a full bus, no two alike."""
    count = int(AWAY_S / EACH_S)
    return [
        Reading(UNITS[place % len(UNITS)], since + place * EACH_S, place, place, 0, 0x40, 0x02)
        for place in range(count)
    ]


def test_ten_minutes_are_delivered_at_their_own_times(tmp_path: Path) -> None:
    store, tokens = people()
    copytree(store, tmp_path / "data")
    number = free_port()
    url = f"http://127.0.0.1:{number}"
    line, outbox = Polling(), Outbox()
    kept = ten_minutes(line.since)
    for reading in kept:
        outbox.put([reading])
    config = configured(tmp_path, number)
    token = command(config, "token", "create", "far", "--role", "worker", "--bus", "far").strip()
    uplink = Uplink([url], token, outbox, line, line.app_clock, time.time)
    with at_work(uplink), served(config):
        eventually(lambda: outbox.connected and not len(outbox), "everything delivered", within=PROCEDURE_S)
        for unit in UNITS:
            series = _history(url, tokens["viewer"], unit, line.since)
            own = [reading for reading in kept if reading.unit == unit]
            assert [round(at, 3) for at in series["t"]] == [round(each.at, 3) for each in own]
            assert series["max"] == [each.actual for each in own]
            assert series["bucket_s"] == 0, "every reading itself"


@contextmanager
def at_work(uplink: Uplink) -> Iterator[None]:
    """Run it on a separate event loop."""
    loop = asyncio.new_event_loop()
    running = loop.create_task(uplink.run())
    thread = threading.Thread(target=lambda: loop.run_until_complete(asyncio.wait([running])))
    thread.start()
    try:
        yield
    finally:
        loop.call_soon_threadsafe(running.cancel)
        thread.join()
        loop.close()


def configured(folder: Path, number: int) -> Path:
    """The lineside.toml of a bus whose port is not on this machine."""
    config = folder / "lineside.toml"
    units = "".join(f'[[bus.unit]]\nid = {unit}\nname = "Unit {unit}"\n' for unit in UNITS)
    config.write_text(
        f'[server]\nport = {number}\ndata = "./data"\n'
        f'[[bus]]\nname = "far"\nport = "{folder}/not-here"\n{units}'
    )
    return config


@contextmanager
def served(config: Path) -> Iterator[None]:
    """``lineside serve`` until the end of the block."""
    with (config.parent / "serve.log").open("wb") as log:
        server = fork_server.start("serve", "--config", config, stdout=log, stderr=log)
        try:
            yield
        finally:
            end(server)


def _history(url: str, token: str, unit: int, since: float) -> dict[str, Any]:
    span = {"from": _iso(since - 1), "to": _iso(since + AWAY_S + 1)}
    query = {"bus": "far", "unit": unit, "value": "actual", "points": 20_000, "format": "epoch", **span}
    headers = {"Authorization": f"Bearer {token}"}
    response = httpx.get(f"{url}/api/v1/history", params=query, headers=headers, timeout=60, trust_env=False)
    assert response.status_code == 200, response.text
    series: dict[str, Any] = response.json()
    return series


def _iso(at: float) -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(at))
