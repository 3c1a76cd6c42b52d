"""The simulated line at real ports: pseudo-terminal and TCP, pulled and plugged, driven from outside."""

from __future__ import annotations

import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial

from bus.settings import Dialect
from bus.simulator.line import SimulatedLine, WireEventKind
from bus.simulator.plant import demo_line
from bus.simulator.ports import Port, PtyPort, TcpLinePort
from bus.simulator.serve import LineServer, control_port
from bus.wire.commands import (
    Ack,
    Nak,
    ReadParameterRequest,
    ReadStatusRequest,
    Reply,
    Request,
    SetAndExecuteSpeedRequest,
    StatusReply,
    encode_request,
    parse_reply,
)
from bus.wire.framing import FrameDecoder, ReceivedFrame
from tests import fork_server
from tests.simulator_remote import Remote

PLAIN = Dialect()
PATIENCE_S = 60.0


def exchange(port: serial.SerialBase, request: Request, patience_s: float = PATIENCE_S) -> Reply | None:
    """One exchange of a plain blocking host; None when nothing came in time."""
    port.write(encode_request(request, PLAIN))
    decoder, until = FrameDecoder(PLAIN), time.monotonic() + patience_s
    while time.monotonic() < until:
        for event in decoder.feed(port.read(1)):
            if isinstance(event, ReceivedFrame):
                return parse_reply(request, event.body, PLAIN)
    return None


def opened(name: str, baud: int = 9600) -> serial.SerialBase:
    return serial.serial_for_url(name, baud, timeout=0.05)


def use_until_it_fails(host: serial.SerialBase) -> None:
    while True:
        exchange(host, ReadStatusRequest(1), patience_s=0.1)


def hang_up(host: serial.SerialBase) -> None:
    """pySerial leaves a socket open that the other side has closed first."""
    getattr(host, "_socket", host).close()


def served(port: Port, units: int = 2) -> LineServer:
    return LineServer(SimulatedLine(demo_line(units, script=False).plant, speedup=50), port)


@pytest.fixture(params=["pty", "tcp"])
def line(request: pytest.FixtureRequest) -> Iterator[LineServer]:
    with served(PtyPort() if request.param == "pty" else TcpLinePort()) as server:
        yield server


def test_every_byte_value_passes_the_port_unchanged(line: LineServer) -> None:
    """No echo, no line discipline: 0Ah, 0Dh, 03h, 11h, 13h and 1Ah are data like any other."""
    with opened(line.port.name) as host:
        for raw in (0x0A0D, 0x0311, 0x131A, 0x0410, 0x1C7F):
            line.call(lambda line, raw=raw: line.plant.unit(1).memory.update({2: 99999, 20: raw}))
            reply = exchange(host, ReadStatusRequest(1))
            assert isinstance(reply, StatusReply)
            assert reply.commanded == raw
        written = line.call(lambda line: [entry.data for entry in line.record.since(0, WireEventKind.CAME)])
        assert b"".join(written) == encode_request(ReadStatusRequest(1), PLAIN) * 5


def test_a_pulled_adapter_comes_back_as_another_device_behind_the_same_link(tmp_path: Path) -> None:
    link = tmp_path / "by-id"
    port = PtyPort(link)
    with served(port) as line:
        devices = [port.device]
        assert link.resolve() == Path(devices[0])
        for _ in range(3):
            line.unplug()
            assert not link.exists()
            line.plug()
            assert port.device != devices[-1]
            devices.append(port.device)
            with opened(str(link)) as host:
                assert exchange(host, ReadStatusRequest(1))
    assert not link.is_symlink()


def test_a_host_at_the_wrong_rate_receives_nothing() -> None:
    with served(PtyPort()) as line, opened(line.port.name, 4800) as host:
        assert exchange(host, ReadStatusRequest(1), patience_s=0.3) is None
        host.baudrate = 9600
        assert exchange(host, ReadStatusRequest(1))


def test_a_tcp_port_serves_one_host_at_a_time() -> None:
    with served(TcpLinePort()) as line, opened(line.port.name) as first:
        assert exchange(first, ReadStatusRequest(1))
        second = opened(line.port.name)
        with pytest.raises(serial.SerialException):
            use_until_it_fails(second)
        hang_up(second)
        assert exchange(first, ReadStatusRequest(1))


def test_remote_control() -> None:
    with served(PtyPort()) as line, opened(line.port.name) as host, control_port(line) as number:
        remote = Remote(number)
        try:
            assert remote.do("port") == line.port.name
            remote.do("mode", unit=1, to="local")
            assert exchange(host, SetAndExecuteSpeedRequest(1, 500)) == Nak(1, 0x80)
            remote.do("mode", unit=1, to="remote")
            assert exchange(host, SetAndExecuteSpeedRequest(1, 500)) == Ack(1)
            assert remote.do("state", unit=1)["setpoint"] == 500
            remote.do("input", unit=1, input="estop", on=True)
            reply = exchange(host, ReadStatusRequest(1))
            assert isinstance(reply, StatusReply)
            assert not reply.inputs & 2
            assert remote.do("parameter", unit=1, number=6, raw=77) == 77
            remote.do("fault", kind="dead", rate=1, unit=1)
            assert exchange(host, ReadStatusRequest(1), patience_s=0.3) is None
            remote.do("clear")
            assert exchange(host, ReadStatusRequest(1))
            acted = remote.do("record", kinds=["acted"])
            assert [(entry["unit"], entry["hex"]) for entry in acted] == [(1, "01 84 00 00 01 f4")]
            assert remote.do("record", kinds=["acted"], since=acted[-1]["number"]) == []
            place = remote.do("spare", parameters={17: 2}, last_parameter=20)
            assert remote.do("parameter", place=place, number=17, raw=9) == 9
            assert exchange(host, ReadParameterRequest(9, 21)) == Nak(9, 0x82)
            remote.do("remove", unit=9)
            assert exchange(host, ReadStatusRequest(9), patience_s=0.3) is None
            remote.do("unplug")
            remote.do("plug")
            for action in ({"do": "fly"}, {"do": "mode", "unit": 99, "to": "local"}):
                with pytest.raises(RuntimeError):
                    remote.do(action.pop("do"), **action)
        finally:
            remote.close()


@pytest.mark.parametrize("ending", [signal.SIGTERM, signal.SIGINT])
def test_the_command_prints_the_port_first_and_ends_cleanly(tmp_path: Path, ending: signal.Signals) -> None:
    link = tmp_path / "line"
    call = ("simulate", "--units", "3", "--link", link, "--control", "0")
    process = fork_server.start(*call, stdout=subprocess.PIPE)
    assert process.stdout is not None
    with process.stdout as printed:
        assert printed.readline().strip() == str(link)
        remote = Remote(int(printed.readline().rsplit(":", 1)[1]))
        assert remote.do("state", unit=3)["mode"] == "remote"
        remote.close()
        with opened(str(link)) as host:
            assert exchange(host, ReadStatusRequest(3))
        process.send_signal(ending)
        assert process.wait(PATIENCE_S) == 0
    assert not link.is_symlink()


@pytest.mark.parametrize("wrong", [["--baud", "1234"], ["--units", "256"], ["--tcp", "0", "--link", "x"]])
def test_wrong_use_is_refused_in_words(wrong: list[str]) -> None:
    done = fork_server.run("simulate", *wrong)
    assert done.returncode == 2
    assert wrong[-2] in done.stderr
