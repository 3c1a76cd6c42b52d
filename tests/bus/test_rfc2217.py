"""``rfc2217://``: units behind a device server whose baud rate is set from here."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import pytest

from bus.contract import Reading, SetSpeed
from bus.errors import WireError
from bus.line.open_port import open_port
from bus.line.port import PortUnavailable
from bus.settings import BusSettings, Dialect, UnitSettings
from bus.simulator.line import SimulatedLine
from bus.simulator.plant import demo_line
from bus.simulator.ports import PtyPort
from bus.simulator.serve import LineServer
from bus.wire.commands import SetAndExecuteSpeedRequest, encode_request
from bus.worker.service import run_worker
from tests.bus.fake_app import TOKEN, FakeApp
from tests.bus.rfc2217_server import DeviceServer
from tests.bus.test_device_server import IN_USE, sending
from tests.bus.test_open_port import POLL, Receiver, on_both_loops

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


@on_both_loops
async def test_a_missing_server_is_reported() -> None:
    with pytest.raises(PortUnavailable, match=r"rfc2217://127\.0\.0\.1:1 (refuses|cannot be)"):
        await open_port("rfc2217://127.0.0.1:1", 9600, Receiver())


@pytest.mark.parametrize("options", [b"", b"\xff\xfb\x2c\xff\xfd\x2c\xff\xfa\x2c\x64\x00\xff\xf0"])
async def test_a_port_that_another_client_has_is_named(options: bytes) -> None:
    """ser2net states it as data, after the options of Telnet, and closes."""
    async with sending(options, b"Port already in use\r\n", closes=True) as number:
        with pytest.raises(PortUnavailable) as raised:
            await open_port(f"rfc2217://127.0.0.1:{number}", 9600, Receiver())
    assert IN_USE in str(raised.value)


async def test_a_worker_reads_and_writes_through_it(server: DeviceServer) -> None:
    units = (UnitSettings(id=1, name="A"), UnitSettings(id=2, name="B"))
    bus = BusSettings(name="b", port=server.url, unit=units)
    leave = asyncio.Event()
    async with FakeApp() as app:
        working = asyncio.create_task(run_worker(bus, [app.url], TOKEN, leave=leave))
        await app.until(lambda: app.readings(1) and app.readings(2))
        result = await app.perform(SetSpeed(2, 255))
        assert (result.outcome, result.read_back) == ("verified", 255)
        server.hang_up()
        seen = len([update for update in app.updates() if isinstance(update, Reading)])
        await app.until(
            lambda: len([update for update in app.updates() if isinstance(update, Reading)]) > seen + 20
        )
        leave.set()
        await working
