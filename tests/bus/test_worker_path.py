"""The complete path: simulated units on a real pseudo-terminal, a worker process, a WebSocket, an app."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from msgspec.structs import replace

from bus.catalogue import parameters as numbers
from bus.contract import (
    Batch,
    BusFigures,
    BusLink,
    Cancel,
    ExecuteAll,
    ExecuteSpeed,
    Frames,
    Hello,
    ReadParameters,
    ReadTrace,
    SetLine,
    SetSpeed,
    WantSnapshot,
    Watch,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from bus.simulator.line import FaultKind, SimulatedLine, WireEventKind
from bus.simulator.plant import demo_line
from bus.simulator.ports import Port, PtyPort, TcpLinePort
from bus.simulator.serve import LineServer
from bus.simulator.unit import Mode
from tests import fork_server
from tests.bus.fake_app import TOKEN, FakeApp
from tests.fork_server import ForkedProcess

UNITS = 3


@pytest.fixture(params=["pty"])
def line(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[LineServer]:
    port: Port = PtyPort(tmp_path / "by-id") if request.param == "pty" else TcpLinePort()
    with LineServer(SimulatedLine(demo_line(UNITS, script=False).plant), port) as server:
        yield server


def config(line: LineServer, folder: Path, units: int = UNITS) -> Path:
    rows = [f'[[bus.unit]]\nid = {unit}\nname = "Unit {unit}"' for unit in range(1, units + 1)]
    file = folder / "lineside.toml"
    # The simulated units share this process: on a busy machine a response may begin late.
    bus = f'[[bus]]\nname = "b"\nport = "{line.port.name}"\nturnaround_ms = 500\n'
    file.write_text(bus + "\n".join(rows) + "\n")
    return file


@asynccontextmanager
async def worker(file: Path, app: FakeApp) -> AsyncIterator[ForkedProcess]:
    """Run a worker process, which must end on SIGTERM."""
    process = fork_server.start(
        *("--config", file, "--bus", "b", "--app", app.url),
        program="bus",
        env={**os.environ, "LINESIDE_WORKER_TOKEN": TOKEN},
        stderr=asyncio.subprocess.PIPE,
    )
    assert process.stderr is not None
    with process.stderr as log:
        try:
            yield process
        finally:
            process.terminate()
            errors = await asyncio.to_thread(log.read)
            print(errors)
        assert await asyncio.to_thread(process.wait) == 0, errors


@asynccontextmanager
async def running(line: LineServer, folder: Path, units: int = UNITS) -> AsyncIterator[FakeApp]:
    """Run an app with a worker whose units have all responded once."""
    async with FakeApp() as app, worker(config(line, folder, units), app):
        await app.until(lambda: all(app.readings(unit) for unit in range(1, UNITS + 1)))
        yield app


async def test_it_sends_hello_then_a_snapshot_then_changes(line: LineServer, tmp_path: Path) -> None:
    async with running(line, tmp_path) as app:
        assert isinstance(app.messages[0], Hello)
        assert app.messages[0].bus == "b"
        assert app.messages[1] in app.snapshots()
        await app.until(lambda: any(isinstance(update, BusFigures) for update in app.updates()))
        sequence = [batch.seq for batch in app.batches()]
        first = app.snapshots()[0].seq + 1
        assert sequence == list(range(first, first + len(sequence)))
        reading = app.readings(2)[-1]
        assert reading.commanded == line.call(lambda simulated: simulated.plant.unit(2).commanded)


async def test_every_action_of_the_contract_has_its_outcome(line: LineServer, tmp_path: Path) -> None:
    async with running(line, tmp_path) as app:
        await app.until(lambda: {1, 2, 3} <= app.read(8))
        result = await app.perform(SetSpeed(1, 700))
        assert (result.outcome, result.read_back) == ("verified", 700)
        assert [frame.direction for frame in result.frames] == ["out", "in", "out", "in"]
        assert (await app.perform(SetSpeed(2, 800, execute=False))).outcome == "acknowledged"
        assert (await app.perform(ExecuteSpeed(2))).outcome == "verified"
        assert (await app.perform(WriteOutput(1, 3, True))).outcome == "verified"
        assert (await app.perform(WriteAnalogOutput(1, 100))).outcome == "acknowledged"
        result = await app.perform(WriteParameter(1, 6, 123))
        assert (result.outcome, result.read_back) == ("verified", 123)
        result = await app.perform(ReadParameters(1))
        assert [value.number for value in result.values] == list(range(1, 41))
        result = await app.perform(SetLine({1: 401, 2: 402, 3: 403}))
        assert result.outcome == "verified"
        assert [unit.read_back for unit in result.units] == [401, 402, 403]
        assert result.skew_s is not None
        assert (await app.perform(ExecuteAll())).outcome == "verified"
        assert [line.call(lambda simulated, u=u: simulated.plant.unit(u).setpoint) for u in (1, 2, 3)] == [
            401,
            402,
            403,
        ]


async def test_a_limit_of_the_scan_bounds_the_polls_and_no_command(line: LineServer, tmp_path: Path) -> None:
    file = config(line, tmp_path)
    file.write_text(file.read_text().replace("turnaround_ms", "max_scan_hz = 0.5\nturnaround_ms"))
    async with FakeApp() as app, worker(file, app):
        await app.until(lambda: any(isinstance(update, BusFigures) for update in app.updates()))
        figures = [update for update in app.updates() if isinstance(update, BusFigures)][-1]
        assert (figures.scan_hz, figures.scan_s) == (0.5, 2.0)
        assert (await app.perform(SetLine({1: 401, 2: 402, 3: 403}))).outcome == "verified"
        await app.until(lambda: len(app.readings(3)) > 2)


async def test_a_refusal_is_final_and_sent_once(line: LineServer, tmp_path: Path) -> None:
    line.line.plant.unit(2).memory[numbers.CONTROL_MODE] = Mode.LOCAL
    async with running(line, tmp_path) as app:
        result = await app.perform(SetSpeed(2, 100))
        assert (result.outcome, result.unit_error, result.units[0].attempts) == ("refused", 0x80, 1)
        assert "REMOTE" in str(result.message)


async def test_the_same_id_is_carried_out_once(line: LineServer, tmp_path: Path) -> None:
    async with running(line, tmp_path) as app:
        await app.perform(SetSpeed(1, 640), command_id="twice")
        await app.perform(SetSpeed(1, 640), command_id="twice")
        await app.until(lambda: len(app.results("twice")) == 2)
        acted = line.call(lambda simulated: list(simulated.record.since(0, WireEventKind.ACTED)))
        assert len(acted) == 1
        first, again = app.results("twice")
        assert again == replace(first, frames=[])


async def test_a_command_that_was_held_up_is_never_sent(line: LineServer, tmp_path: Path) -> None:
    async with running(line, tmp_path) as app:
        result = await app.perform(SetSpeed(1, 640), timeout_s=-0.5)
        assert result.outcome == "not_sent"
        assert not line.call(lambda simulated: list(simulated.record.since(0, WireEventKind.ACTED)))


async def test_a_pulled_cable_is_seen_and_the_line_found_under_its_new_name(
    line: LineServer, tmp_path: Path
) -> None:
    async with running(line, tmp_path) as app:
        line.unplug()
        await app.until(lambda: _bus_links(app)[-1:] == ["closed"])
        result = await app.perform(SetSpeed(1, 640))
        assert result.outcome == "bus_closed"
        line.plug()
        await app.until(lambda: _bus_links(app)[-1:] == ["open"])
        seen = len(app.readings(1))
        await app.until(lambda: len(app.readings(1)) > seen)
        assert not line.call(lambda simulated: list(simulated.record.since(0, WireEventKind.ACTED)))


async def many_polls(line: LineServer) -> None:
    """Wait while a worker polls the units."""
    before = line.call(lambda simulated: simulated.record.count)
    for _ in range(1200):
        if line.call(lambda simulated: simulated.record.count) > before + 100:
            return
        await asyncio.sleep(0.05)
    raise AssertionError("the units are no longer polled")


async def test_readings_are_kept_while_the_app_is_away(line: LineServer, tmp_path: Path) -> None:
    async with running(line, tmp_path) as app:
        await app.stop()
        last = app.readings()[-1].at
        received = len(app.messages)
        await many_polls(line)
        until = time.time()
        await app.start()
        await app.until(
            lambda: any(isinstance(each, Batch) and each.live for each in app.messages[received:])
        )
        kept = [batch for batch in app.batches() if not batch.live]
        assert kept
        times = [reading.at for reading in app.readings()]
        assert times == sorted(set(times)), "in order, and none twice"
        assert [at for at in times if last < at < until], "the time without the app is no hole"
        assert len({batch.seq for batch in app.batches()}) == len(app.batches())


async def test_the_trace_is_sent_while_followed_and_read_on_request(line: LineServer, tmp_path: Path) -> None:
    async with running(line, tmp_path) as app:
        assert not [update for update in app.updates() if isinstance(update, Frames)]
        await app.send(Watch(units=[1], trace=True))
        await app.until(lambda: sum(isinstance(update, Frames) for update in app.updates()) > 60)
        result = await app.perform(ReadTrace(since=0.0, limit=50))
        assert len(result.frames) == 50
        assert "read speed and status" in result.frames[0].meaning
        later = await app.perform(ReadTrace(since=result.frames[-1].at, limit=10))
        assert later.frames[0].at >= result.frames[-1].at


async def test_a_snapshot_is_repeated_on_request(line: LineServer, tmp_path: Path) -> None:
    async with running(line, tmp_path) as app:
        await app.send(WantSnapshot())
        await app.until(lambda: len(app.snapshots()) == 2)
        snapshot = app.snapshots()[1]
        assert [unit.link.link for unit in snapshot.units] == ["online"] * UNITS
        after = app.batches()[-1].seq
        await app.until(lambda: app.batches()[-1].seq > after)


async def test_a_waiting_command_can_be_given_up(line: LineServer, tmp_path: Path) -> None:
    async with running(line, tmp_path) as app:
        line.call(lambda simulated: simulated.faults.set(FaultKind.DEAD, 1.0, 2))
        command = asyncio.create_task(app.perform(ReadParameters(1, urgent=False), command_id="slow"))
        await app.until(lambda: any(getattr(update, "id", "") == "slow" for update in app.updates()))
        await app.send(Cancel("slow"))
        result = await command
        assert result.outcome in ("unverified", "not_sent")


async def test_a_refused_worker_logs_the_reason(line: LineServer, tmp_path: Path) -> None:
    async with FakeApp() as app:
        app.refuses = "install the same release"
        async with worker(config(line, tmp_path), app) as process:
            assert process.stderr is not None
            async with asyncio.timeout(60):
                while "install the same release" not in await asyncio.to_thread(process.stderr.readline):
                    pass


def _links(app: FakeApp) -> list[BusLink]:
    return [snapshot.bus for snapshot in app.snapshots()] + [
        update for update in app.updates() if isinstance(update, BusLink)
    ]


def _bus_links(app: FakeApp) -> list[str]:
    return [link.link for link in _links(app)]
