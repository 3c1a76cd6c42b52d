"""Another program changes the settings of the open port: they are put back, and that is reported once."""

from __future__ import annotations

import asyncio
import fcntl
import os
import struct
import subprocess
import sys
import termios
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from app.line.live.change_recorder import ChangeDetector
from bus.contract import BusFigures, BusLink
from bus.line import opener
from bus.line.device import PortSettings, differences, open_device
from bus.messages import Message
from bus.settings import BusSettings, Dialect, UnitSettings
from bus.simulator.line import SimulatedLine, WireEventKind
from bus.simulator.plant import demo_line
from bus.simulator.ports import PtyPort
from bus.simulator.serve import LineServer
from bus.wire.framing import FrameDecoder, ReceivedFrame, encode_frame
from bus.worker import service
from bus.worker.service import run_worker
from tests.bus.fake_app import TOKEN, FakeApp
from tests.sizes import sizes

FOREIGN = ("sane", "istrip", "0", "icanon", "min 200", "echo icrnl ixon onlcr opost isig iexten 300 cstopb")
"""Of each kind: of all, the input, the speed, the lines, what a read waits for, and several at once."""
OTHERS = (
    *("icrnl", "inlcr", "igncr", "ixon", "1200", "echo", "-raw", "cooked", "isig", "parmrk inpck", "opost"),
    *("opost onlcr", "opost ocrnl", "iuclc", "opost olcuc", "cstopb", "crtscts", "hupcl", "-clocal"),
    *("time 50",),
)


UNITS = (13, 17)
"""Units 0Dh and 11h: CR and XON are in their frames."""


@pytest.fixture
def line() -> Iterator[LineServer]:
    plant = demo_line(17, script=False).plant
    with LineServer(SimulatedLine(plant, speedup=5), PtyPort()) as server:
        yield server


@pytest.fixture(autouse=True)
def _reports_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(service, "FIGURES_S", 0.1)
    monkeypatch.setattr(opener, "CHECK_S", 0.1)


@asynccontextmanager
async def working(line: LineServer) -> AsyncIterator[FakeApp]:
    """A worker on the line, each unit read once."""
    units = tuple(UnitSettings(id=unit, name=f"U{unit}") for unit in UNITS)
    leave = asyncio.Event()
    async with FakeApp() as app:
        bus = BusSettings(name="b", port=line.port.name, unit=units)
        worker = asyncio.create_task(run_worker(bus, [app.url], TOKEN, leave=leave))
        await further(app)
        yield app
        leave.set()
        await worker


async def further(app: FakeApp) -> None:
    """Wait until each unit was read again several times."""
    seen = {unit: len(app.readings(unit)) for unit in UNITS}
    await app.until(lambda: all(len(app.readings(unit)) > seen[unit] + 2 for unit in UNITS))


async def stty(line: LineServer, words: str) -> None:
    await stty_of(line.port.name, words)


async def stty_of(name: str, words: str) -> None:
    """Its exit code means nothing: the settings may be put back before it verifies them."""
    process = await asyncio.create_subprocess_exec(
        *("stty", "-F", name, *words.split()), stderr=asyncio.subprocess.DEVNULL
    )
    await process.wait()


def figures(app: FakeApp) -> list[BusFigures]:
    return [each for each in app.updates() if isinstance(each, BusFigures)]


def events(app: FakeApp) -> list[str]:
    """What is recorded of all that was reported."""
    changes = ChangeDetector(BusSettings(name="b", port="/dev/ttyUSB0"))
    return [str(event.what) for update in figures(app) for event in changes.detect(update)]


async def reported(app: FakeApp) -> list[str]:
    """Every event, once the first one and further figures are there."""
    await app.until(lambda: bool(events(app)))
    count = len(figures(app))
    await app.until(lambda: len(figures(app)) > count + 1)
    return events(app)


@pytest.mark.parametrize("words", [*sizes(*FOREIGN[:1], *OTHERS, *FOREIGN[2:5]), FOREIGN[1], FOREIGN[5]])
async def test_units_come_back_and_it_is_reported_once(line: LineServer, words: str) -> None:
    async with working(line) as app:
        await stty(line, words)
        await further(app)
        found = await reported(app)
        assert len(found) == 1, found
        assert found[0].startswith("Another program changed the settings of the port: ")
        assert found[0] in map(str, figures(app)[-1].diagnosis)
        lost = [each for each in app.updates() if isinstance(each, BusLink) and each.link == "closed"]
        assert lost == []


async def test_a_response_is_echoed_to_the_drives_once_at_most(line: LineServer) -> None:
    def echoed(simulated: SimulatedLine) -> int:
        came = b"".join(each.data for each in simulated.record.since(0, WireEventKind.CAME))
        return sum(came.count(bytes((0x10, 0x02, unit, 0x06))) for unit in UNITS)

    async with working(line) as app:
        for _ in range(5):
            before = line.call(echoed)
            await stty(line, "echo")
            await further(app)
            assert line.call(echoed) - before <= 1
        assert await reported(app) == [
            "Another program changed the settings of the port: echo. They were put back."
        ]


async def test_a_program_that_has_the_port_open_is_named_once(line: LineServer) -> None:
    async with working(line) as app:
        held = f"held = open({line.port.name!r}, 'rb', buffering=0); print(flush=True); input()"
        pipe = asyncio.subprocess.PIPE
        other = await asyncio.create_subprocess_exec(sys.executable, "-c", held, stdin=pipe, stdout=pipe)
        assert other.stdout is not None
        try:
            await other.stdout.readline()
            await stty(line, "icrnl")
            found = await reported(app)
        finally:
            other.kill()
            await other.communicate()
    program = f"(process {other.pid})"
    assert len(found) == 2, found
    assert all(program in each for each in found)
    assert "icrnl" in found[0]
    assert "has the port open too" in found[1]


@pytest.fixture
def terminal() -> Iterator[int]:
    master, slave = os.openpty()
    yield slave
    os.close(master)
    os.close(slave)


class Received(bytearray):
    """What a port gave to its receiver."""

    def __init__(self) -> None:
        super().__init__()
        self._came = asyncio.Event()

    def data_received(self, data: bytes) -> None:
        self.extend(data)
        self._came.set()

    async def complete(self, expected: bytes) -> None:
        """Wait for ``expected``, and nothing before it."""
        while self != expected:
            await self._came.wait()
            self._came.clear()
            assert expected.startswith(self)

    def connection_lost(self, cause: Message) -> None:
        raise AssertionError(cause)


@pytest.mark.parametrize("looks", ["none", "at what is beside it", "before the next request"])
async def test_what_came_in_under_foreign_settings_is_dropped(looks: str) -> None:
    """Without the highest bits of an even number of bytes, the checksum of a false speed is right."""
    master, slave = os.openpty()
    response = encode_frame(bytes.fromhex("02 06 00 00 1B 4E 00 00 1A CE 00 80 01"), Dialect())
    stripped = bytes(byte & 0x7F for byte in response)
    (event,) = FrameDecoder(Dialect()).feed(stripped)
    assert isinstance(event, ReceivedFrame)
    received = Received()
    port = await open_device(os.ttyname(slave), 9600, received)
    await stty_of(os.ttyname(slave), "istrip")
    os.write(master, response)
    changed = []
    if looks == "at what is beside it":
        changed = port.check()
    elif looks == "before the next request":
        port.write(b"request")
    await asyncio.sleep(0.05)
    assert received == b""
    os.write(master, response)
    async with asyncio.timeout(10):
        await received.complete(response)
    assert [*changed, *port.check()] == ["istrip"]
    port.close()
    os.close(master)
    os.close(slave)


def test_a_device_without_modem_lines_has_only_what_termios_knows(terminal: int) -> None:
    settings = PortSettings(terminal)
    settings.restore_controls()
    assert settings.take_changed() == []


def test_what_a_port_was_opened_with_does_not_matter(terminal: int) -> None:
    subprocess.run(["stty", "-F", os.ttyname(terminal), "sane"], check=True)
    PortSettings(terminal)
    iflag, oflag, _, lflag, *_ = termios.tcgetattr(terminal)
    assert (iflag, oflag, lflag) == (0, 0, 0)


def test_what_is_beside_termios_is_kept_too(terminal: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A serial port of the kernel as it is seen through its requests."""
    serial_struct = bytearray(128)
    device: dict[str, dict[int, Any]] = {
        "get": {termios.TIOCMGET: struct.pack("I", 0x126), 0x542E: bytes(32), termios.TIOCGETD: bytes(4)},
        "set": {termios.TIOCMSET: termios.TIOCMGET, 0x542F: 0x542E, termios.TIOCSETD: termios.TIOCGETD},
    }
    serial_struct[17] = 0x20
    device["get"][termios.TIOCGSERIAL] = bytes(serial_struct)
    device["set"][termios.TIOCSSERIAL] = termios.TIOCGSERIAL
    opened = dict(device["get"])

    def ioctl(_descriptor: int, request: int, argument: bytes) -> bytes:
        if (stored := device["set"].get(request)) is not None:
            device["get"][stored] = argument
        return device["get"].get(request, argument)

    monkeypatch.setattr(fcntl, "ioctl", ioctl)
    settings = PortSettings(terminal)
    settings.restore_controls()
    assert settings.take_changed() == []
    device["get"][termios.TIOCMGET] = struct.pack("I", 0x120)
    device["get"][0x542E] = b"\x01" + bytes(31)
    device["get"][termios.TIOCGETD] = struct.pack("I", 3)
    device["get"][termios.TIOCGSERIAL] = bytes(128)
    settings.restore_controls()
    assert settings.take_changed() == ["line discipline", "rs485", "dtr/rts", "low_latency"]
    assert device["get"] == opened
    device["get"][termios.TIOCMGET] = struct.pack("I", 0x106)
    settings.restore_controls()
    assert settings.take_changed() == [], "input lines are no setting"


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("icrnl -hupcl 1200 cstopb", ["1200 baud", "icrnl", "cstopb", "-hupcl"]),
        ("icanon min 7", ["icanon", "min 7"]),
    ],
)
def test_a_difference_has_the_words_of_stty(terminal: int, words: str, named: list[str]) -> None:
    PortSettings(terminal)
    subprocess.run(["stty", "-F", os.ttyname(terminal), "9600", "hupcl"], check=True)
    wanted = termios.tcgetattr(terminal)
    subprocess.run(["stty", "-F", os.ttyname(terminal), *words.split()], check=True)
    assert sorted(differences(wanted, termios.tcgetattr(terminal))) == sorted(named)
