"""Ports: pseudo-terminals and TCP, opened, used, kept open, lost; and why one cannot be opened."""

from __future__ import annotations

import asyncio
import errno
import inspect
import os
import pty
import socket
import subprocess
import sys
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
import serial
import uvloop

from bus.errors import WireError
from bus.line import device_server as tcp
from bus.line import port as serial_port
from bus.line.line_loop import LineLoop
from bus.line.opener import Opener, open_port
from bus.line.port import OpenPort, PartlySent, PortUnavailable, users_of, why_not
from bus.messages import Message
from bus.settings import Dialect
from bus.simulator.line import SimulatedLine
from bus.simulator.plant import demo_line
from bus.simulator.ports import Port, PtyPort, TcpLinePort
from bus.simulator.serve import LineServer
from bus.wire.commands import ReadStatusRequest, encode_request
from tests.bus.played_clock import PlayedClock

PATIENCE_S = 20.0
POLL = encode_request(ReadStatusRequest(1), Dialect())


class Receiver:
    """Receives from a port."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.lost: list[Message] = []
        self._news = asyncio.Event()

    def data_received(self, data: bytes) -> None:
        self.data += data
        self._news.set()

    def connection_lost(self, cause: Message) -> None:
        self.lost.append(cause)
        self._news.set()

    async def until(self, count: int = 0, *, lost: bool = False) -> None:
        async with asyncio.timeout(PATIENCE_S):
            while len(self.data) < count or (lost and not self.lost):
                self._news.clear()
                await self._news.wait()


def on_both_loops(test: Callable[..., Coroutine[Any, Any, None]]) -> Callable[..., None]:
    """Run an async test on asyncio's loop and on uvloop, which the worker uses."""

    def played(loop: Callable[[], asyncio.AbstractEventLoop], **fixtures: Any) -> None:
        with asyncio.Runner(loop_factory=loop) as runner:
            runner.run(test(**fixtures))

    parameters = [inspect.Parameter("loop", inspect.Parameter.POSITIONAL_OR_KEYWORD)]
    parameters += inspect.signature(test).parameters.values()
    played.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    loops = [asyncio.new_event_loop, uvloop.new_event_loop]
    return pytest.mark.parametrize("loop", loops, ids=["asyncio", "uvloop"])(played)


@pytest.fixture(params=["pty", "tcp"])
def line(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[LineServer]:
    port: Port = PtyPort(tmp_path / "by-id") if request.param == "pty" else TcpLinePort()
    with LineServer(SimulatedLine(demo_line(2, script=False).plant, speedup=20), port) as server:
        yield server


@contextmanager
def terminal() -> Iterator[str]:
    """Yield the name of a pseudo-terminal with no reader at its other end."""
    master, slave = pty.openpty()
    try:
        yield os.ttyname(slave)
    finally:
        os.close(master)
        os.close(slave)


@on_both_loops
async def test_bytes_go_and_come(line: LineServer) -> None:
    receiver = Receiver()
    port = await open_port(line.port.name, 9600, receiver)
    for count in (18, 36):
        port.write(POLL)
        await receiver.until(count)
    port.check()
    port.drop_output()
    port.close()
    await asyncio.sleep(0)
    assert not receiver.lost, "closing a port does not report it as lost"


@on_both_loops
async def test_a_pulled_port_is_reported_once_and_found_again(line: LineServer) -> None:
    receiver = Receiver()
    port = await open_port(line.port.name, 9600, receiver)
    port.write(POLL)
    await receiver.until(18)
    line.unplug()
    async with asyncio.timeout(PATIENCE_S):
        while not receiver.lost:
            try:
                port.check()
                port.write(POLL)
            except WireError as error:
                receiver.connection_lost(error.message)
            await asyncio.sleep(0.05)
    assert line.port.name in str(receiver.lost[0])
    port.close()
    with pytest.raises(PortUnavailable) as absent:
        await open_port(line.port.name, 9600, Receiver())
    assert line.port.name in str(absent.value)
    line.plug()
    again = Receiver()
    port = await open_port(line.port.name, 9600, again)
    port.write(POLL)
    await again.until(18)
    port.close()
    await asyncio.sleep(0.01)


@on_both_loops
async def test_closing_never_waits_for_undelivered_bytes() -> None:
    with terminal() as name:
        port = await open_port(name, 300, Receiver())
        with pytest.raises(WireError, match=r"handshake|accepted"):
            _fill(port)
        began = asyncio.get_running_loop().time()
        port.close()
        await asyncio.sleep(0.01)
        assert asyncio.get_running_loop().time() - began < PATIENCE_S, "its bytes never arrive"


@on_both_loops
async def test_bytes_without_a_reader_gather_and_a_lost_port_is_noticed() -> None:
    master, slave = pty.openpty()
    receiver = Receiver()
    port = await open_port(os.ttyname(slave), 9600, receiver)
    port.listen(now=False)
    for byte in (b"a", b"b", b"c"):
        os.write(master, byte)
        await asyncio.sleep(0.01)
    assert not receiver.data
    port.listen(now=True)
    await receiver.until(3)
    assert receiver.data == b"abc"
    port.listen(now=False)
    os.close(slave)
    os.close(master)
    await receiver.until(3, lost=True)
    assert receiver.data == b"abc"
    port.listen(now=True)
    port.close()


@on_both_loops
async def test_a_port_that_takes_half_a_request_reports_it(monkeypatch: pytest.MonkeyPatch) -> None:
    with terminal() as name:
        port = await open_port(name, 9600, Receiver())
        monkeypatch.setattr(os, "write", lambda _fd, data: len(data) // 2)
        with pytest.raises(PartlySent, match="3 of 7"):
            port.write(POLL)
        monkeypatch.undo()
        port.close()
        await asyncio.sleep(0.01)


@on_both_loops
async def test_a_taken_port_is_named_with_its_holder(monkeypatch: pytest.MonkeyPatch) -> None:
    with terminal() as name:
        holder = await asyncio.create_subprocess_exec(
            *(
                sys.executable,
                "-c",
                f"import serial\nheld = serial.Serial({name!r}, exclusive=True)\ninput('held')",
            ),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
        )
        try:
            assert holder.stdout is not None
            await holder.stdout.readexactly(4)
            assert [pid for pid, _ in users_of(name) if pid == holder.pid]
            for _ in range(2):
                with pytest.raises(PortUnavailable, match=rf"in use by .*\(process {holder.pid}\)"):
                    await open_port(name, 9600, Receiver())
                # The files of all processes are read once, not at each of two attempts a second.
                monkeypatch.setattr(serial_port, "_pids", lambda: pytest.fail("searched again"))
        finally:
            holder.kill()
            await holder.communicate()


@pytest.mark.parametrize(
    ("port", "words"),
    [
        ("/dev/ttyNOSUCH0", "does not exist: is the adapter plugged in?"),
        ("/dev/null", "is not a serial port"),
        ("socket://127.0.0.1:1", "refuses the connection"),
        ("socket://127.0.0.1", "needs a host and a port number"),
        ("rfc2217://127.0.0.1:1", "lineside[rfc2217]"),
    ],
)
@on_both_loops
async def test_why_a_port_cannot_be_opened(port: str, words: str) -> None:
    if port.startswith("rfc2217") and _has_serialx():
        pytest.skip("the extra is installed here")
    with pytest.raises(PortUnavailable) as raised:
        await open_port(port, 9600, Receiver())
    assert words in str(raised.value)
    assert port in str(raised.value)


def test_a_missing_right_is_reported_with_the_group_that_has_it() -> None:
    denied = serial.SerialException(errno.EACCES, "could not open port")
    assert "usermod -aG root" in str(why_not("/dev/null", denied))


@on_both_loops
async def test_a_server_that_never_responds_does_not_stop_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tcp, "CONNECT_TIMEOUT_S", 0.2)
    full = socket.socket()
    full.bind(("127.0.0.1", 0))
    full.listen(0)
    waiting = [socket.socket() for _ in range(4)]
    try:
        for each in waiting:
            each.setblocking(False)
            each.connect_ex(full.getsockname())
        with pytest.raises(PortUnavailable, match=r"does not respond|refuses"):
            await open_port(f"socket://127.0.0.1:{full.getsockname()[1]}", 9600, Receiver())
    finally:
        for each in (*waiting, full):
            each.close()


@on_both_loops
async def test_a_device_servers_rate_is_not_ours_to_set() -> None:
    with LineServer(SimulatedLine(demo_line(1, script=False).plant, speedup=20), TcpLinePort()) as line:
        port = await open_port(line.port.name, 9600, Receiver())
        with pytest.raises(WireError, match="device server"):
            port.retune(4800)
        port.close()


def _fill(port: OpenPort) -> None:
    for _ in range(20_000):
        port.write(bytes(100))


def _has_serialx() -> bool:
    try:
        import serialx  # noqa: F401
    except ImportError:
        return False
    return True


@pytest.mark.skipif(os.geteuid() != 0, reason="mounts the pseudo-terminals of a container")
def test_the_terminal_of_a_container_is_another_one_of_the_same_name() -> None:
    mount = "mount -t devpts -o newinstance,ptmxmode=666 devpts /dev/pts"
    # Who has its other end too would be taken for the simulator of the line.
    opens = """
import os, pty, sys
ends = [pty.openpty() for _ in range(1 + int(sys.argv[1].removeprefix("/dev/pts/")))]
if not os.fork():
    for master, _ in ends:
        os.close(master)
    print(os.ttyname(ends[-1][1]), os.getpid(), flush=True)
sys.stdin.read()
"""
    with terminal() as name:
        command = ["unshare", "--mount", "sh", "-c", f'{mount} && exec "$0" -c "$1" "$2"']
        with subprocess.Popen(
            [*command, sys.executable, opens, name], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as container:
            assert container.stdout is not None
            opened, _, pid = container.stdout.readline().strip().partition(" ")
            users = users_of(name)
            container.communicate()
        if not opened:
            pytest.skip("nothing can be mounted here")
        assert opened == name
        assert int(pid) not in dict(users)


class WellPort:
    """One that is well until it is closed."""

    is_closed = False

    def check(self) -> list[str]:
        """It is there."""
        return []

    def close(self) -> None:
        self.is_closed = True


async def test_a_port_that_is_lost_in_the_turn_in_which_the_worker_ends_does_not_keep_it() -> None:
    port, opened = WellPort(), asyncio.Event()
    lost: asyncio.Future[Message] = asyncio.get_running_loop().create_future()

    async def run(_port: Any) -> Message:
        opened.set()
        return await lost

    line = SimpleNamespace(
        bus=SimpleNamespace(port="/dev/ttyUSB0"),
        baud=9600,
        clock=PlayedClock(),
        link=SimpleNamespace(has_responses=False),
        run=run,
    )

    async def open_it(*_: Any) -> Any:
        return port

    task = asyncio.create_task(Opener(cast(LineLoop, line), open_it).run())
    await opened.wait()
    await asyncio.sleep(0)
    lost.set_result(Message("adapter_gone"))
    task.cancel()
    done, _ = await asyncio.wait({task}, timeout=20)
    assert done == {task}
    assert task.cancelled()
    assert port.is_closed
