"""``socket://`` and ``rfc2217://`` with faulty device servers: reported, recovered, nothing sent late."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from itertools import groupby

import pytest

from bus.contract import BusLink, SetSpeed
from bus.errors import WireError
from bus.line import opener
from bus.line.device_server import TCP_LOST_AFTER_MS
from bus.line.opener import open_port
from bus.line.port import PortUnavailable
from bus.messages import Message
from bus.settings import BusSettings, Dialect, UnitSettings
from bus.simulator.line import SimulatedLine, WireEventKind
from bus.simulator.plant import demo_line
from bus.simulator.ports import PtyPort, TcpLinePort
from bus.simulator.serve import LineServer
from bus.wire.commands import SetAndExecuteSpeedRequest, encode_request
from bus.worker.service import run_worker
from tests.bus.fake_app import TOKEN, FakeApp
from tests.bus.rfc2217_server import DeviceServer
from tests.bus.test_open_port import POLL, Receiver, on_both_loops

TCP_USER_TIMEOUT = 18
"""Linux, which names it only from Python 3.12 on."""


@pytest.fixture
def line() -> Iterator[LineServer]:
    with LineServer(SimulatedLine(demo_line(2, script=False).plant, speedup=20), TcpLinePort()) as server:
        yield server


@asynccontextmanager
async def working(line: LineServer) -> AsyncIterator[FakeApp]:
    """A worker on the line, both units read once."""
    units = (UnitSettings(id=1, name="A"), UnitSettings(id=2, name="B"))
    bus = BusSettings(name="b", port=line.port.name, unit=units)
    leave = asyncio.Event()
    async with FakeApp() as app:
        worker = asyncio.create_task(run_worker(bus, [app.url], TOKEN, leave=leave))
        await app.until(lambda: app.readings(1) and app.readings(2))
        yield app
        leave.set()
        await worker


def causes(app: FakeApp) -> list[str]:
    return [
        str(update.cause)
        for update in app.updates()
        if isinstance(update, BusLink) and update.link == "closed"
    ]


def states(app: FakeApp) -> list[str]:
    """What the port was, one after the other."""
    links = [update.link for update in app.updates() if isinstance(update, BusLink)]
    return [link for link, _ in groupby(links)]


def number_of(line: LineServer) -> int:
    return int(line.port.name.rpartition(":")[2])


async def test_one_that_accepts_and_drops_is_left_in_peace_and_found_when_it_serves(line: LineServer) -> None:
    accepted = asyncio.Semaphore(0)

    def drop(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        accepted.release()
        writer.close()

    async with working(line) as app:
        line.unplug()
        async with await asyncio.start_server(drop, "127.0.0.1", number_of(line)):
            began = asyncio.get_running_loop().time()
            for _ in range(4):
                await accepted.acquire()
            assert asyncio.get_running_loop().time() - began > 1.0, "it is not hammered"
            result = await app.perform(SetSpeed(1, 777))
        assert result.outcome in ("bus_closed", "unverified", "not_sent")
        assert any(f"{line.port.name} closed the connection" in cause for cause in causes(app))
        assert states(app) == ["open", "closed"], "one loss, although it was opened several times"
        seen = len(app.readings(1))
        line.plug()
        await app.until(lambda: len(app.readings(1)) > seen + 5)
        acted = line.call(lambda simulated: list(simulated.record.since(0, WireEventKind.ACTED)))
        assert acted == [], "nothing is sent late"
        assert (await app.perform(SetSpeed(1, 778))).outcome == "verified"
        assert states(app) == ["open", "closed", "open"]


async def test_a_device_server_before_silent_units_is_back_once_it_stays(
    line: LineServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(opener, "STABLE_S", 0.5)
    connections: list[asyncio.StreamWriter] = []
    async with working(line) as app:
        line.unplug()
        await app.until(lambda: states(app)[-1] == "closed")
        async with await asyncio.start_server(
            lambda _, writer: connections.append(writer), "127.0.0.1", number_of(line)
        ):
            await app.until(lambda: states(app)[-1] == "open")
            for connection in connections:
                connection.close()


async def test_one_that_lost_its_power_is_noticed_by_what_it_does_not_confirm(line: LineServer) -> None:
    """A dead box cannot be had here; what makes the kernel notice one is looked at instead."""
    port = await open_port(line.port.name, 9600, Receiver())
    connection: socket.socket = port._transport.get_extra_info("socket")  # type: ignore[attr-defined]
    assert connection.getsockopt(socket.IPPROTO_TCP, TCP_USER_TIMEOUT) == TCP_LOST_AFTER_MS < 1000
    assert connection.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
    assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
    port.close()


IN_USE = 'in use by another client: the device server reports "Port already in use"'


@pytest.mark.parametrize(
    ("pieces", "cause"),
    [
        ((b"Port already ", b"in use\r\n"), IN_USE),
        ((b"Goodbye\r\n",), 'closed the connection after the text "Goodbye"'),
        ((b"\x10\x02Port already in use",), "closed the connection"),
    ],
)
async def test_the_text_of_a_device_server_at_its_end_is_a_cause_and_no_frame(
    pieces: tuple[bytes, ...], cause: str
) -> None:
    """ser2net's response to a second client: its single connection keeps two servers apart."""
    receiver, lost = Receiver(), asyncio.Event()
    causes: list[str] = []

    def connection_lost(message: Message) -> None:
        causes.append(str(message))
        lost.set()

    receiver.connection_lost = connection_lost  # type: ignore[method-assign]
    async with sending(*pieces, closes=True) as number:
        await open_port(f"socket://127.0.0.1:{number}", 9600, receiver)
        await asyncio.wait_for(lost.wait(), 30)
    assert cause in causes[0]


@asynccontextmanager
async def sending(*pieces: bytes, closes: bool = False) -> AsyncIterator[int]:
    """A device server that sends these to its client, and may close the connection; its port."""
    writers: list[asyncio.StreamWriter] = []

    async def send(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writers.append(writer)
        for piece in pieces:
            writer.write(piece)
            await asyncio.sleep(0.02)
        if closes:
            writer.close()

    async with await asyncio.start_server(send, "127.0.0.1", 0) as server:
        yield server.sockets[0].getsockname()[1]
        for writer in writers:
            writer.close()
            await asyncio.gather(writer.wait_closed(), return_exceptions=True)


pytest.importorskip("serialx", reason="the extra 'rfc2217' is not installed")

ESCAPED = encode_request(SetAndExecuteSpeedRequest(1, 0xFF), Dialect())
"""FFh means something to Telnet, so it goes doubled between the host and the device server."""


@pytest.fixture
def server() -> Iterator[DeviceServer]:
    line = SimulatedLine(demo_line(2, script=False).plant, speedup=20)
    with LineServer(line, PtyPort(follow_speed=False)) as simulated, DeviceServer(simulated.port.name) as box:
        yield box


@on_both_loops
async def test_bytes_go_and_come_whatever_they_are(server: DeviceServer) -> None:
    receiver = Receiver()
    port = await open_port(server.url, 4800, receiver)
    port.write(POLL)
    await receiver.until(18)
    assert server.bauds[-1] == 4800
    port.write(ESCAPED)
    await receiver.until(18 + 7)
    receiver.data.clear()
    port.write(POLL)
    await receiver.until(18)
    assert bytes(receiver.data[4:8]) == b"\0\0\0\xff"
    port.check()
    port.drop_output()
    port.close()
    await asyncio.sleep(0.01)
    assert not receiver.lost


@on_both_loops
async def test_a_server_that_closes_is_reported_once_and_found_again(server: DeviceServer) -> None:
    receiver = Receiver()
    port = await open_port(server.url, 9600, receiver)
    port.write(POLL)
    await receiver.until(18)
    server.hang_up()
    await receiver.until(lost=True)
    assert len(receiver.lost) == 1
    assert server.url in str(receiver.lost[0])
    with pytest.raises(WireError):
        port.check()
    port.close()
    again = Receiver()
    port = await open_port(server.url, 9600, again)
    port.write(POLL)
    await again.until(18)
    port.close()
    await asyncio.sleep(0.01)


@pytest.mark.parametrize("options", [b"", b"\xff\xfb\x2c\xff\xfd\x2c\xff\xfa\x2c\x64\x00\xff\xf0"])
async def test_a_port_that_another_client_has_is_named(options: bytes) -> None:
    """ser2net states it as data, after the options of Telnet, and closes."""
    async with sending(options, b"Port already in use\r\n", closes=True) as number:
        with pytest.raises(PortUnavailable) as raised:
            await open_port(f"rfc2217://127.0.0.1:{number}", 9600, Receiver())
    assert IN_USE in str(raised.value)
