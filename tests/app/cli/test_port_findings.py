"""``lineside check --live`` at the ports: each is tried without a byte, and one in use is left alone."""

from __future__ import annotations

import fcntl
import os
import socket
import subprocess
import sys
import termios
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from app.cli import check_live as port_findings
from app.cli.check_live import is_connected_to, is_worker_of
from app.settings import LOCK_FILE
from bus.line.open_port import port_fault
from tests.app.live_check import bus, check_live, everything_in, pseudo_terminal, run
from tests.free_port import free_port

HOLD = "import os, sys; os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY); print(flush=True); sys.stdin.read()"


@pytest.fixture
def config(tmp_path: Path) -> Path:
    return tmp_path / "lineside.toml"


@pytest.fixture
def terminal() -> Iterator[tuple[int, str]]:
    with pseudo_terminal() as made:
        yield made


@pytest.fixture
def device_server() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(5.0)
        yield listening


def url(server: socket.socket) -> str:
    return f"socket://127.0.0.1:{server.getsockname()[1]}"


def test_a_serial_port_is_opened_and_left_as_it_was(config: Path, terminal: tuple[int, str]) -> None:
    master, path = terminal
    settings = termios.tcgetattr(master)
    config.write_text(bus(path))
    before = everything_in(config.parent)
    result = check_live(config)
    assert (result.exit_code, result.stderr) == (0, "")
    assert f"bus dry-end: {path} opens, and no other program is seen to use it" in result.stdout
    assert termios.tcgetattr(master) == settings
    assert everything_in(config.parent) == before
    fcntl.fcntl(master, fcntl.F_SETFL, os.O_NONBLOCK)
    with pytest.raises(OSError, match="Input/output error"):  # nothing was written, and no program has it
        os.read(master, 1)


@contextmanager
def held(path: str) -> Iterator[int]:
    """Another program has the port open; its process id."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", HOLD, path], **pipes) as program:
        assert program.stdout is not None
        program.stdout.readline()
        yield program.pid
        program.communicate()


def test_the_program_that_has_a_port_is_named_and_it_is_not_opened(
    config: Path, terminal: tuple[int, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, path = terminal
    monkeypatch.setattr("bus.line.open_port.port_fault", lambda _: pytest.fail("opened"))
    with held(path) as pid:
        result = run(config, bus(path))
        assert result.exit_code == 1
        assert f"bus dry-end: {path} is in use by python" in result.stderr
        assert f"(process {pid})" in result.stderr
        monkeypatch.setattr(port_findings, "is_worker_of", lambda *_: True)
        result = run(config, bus(path))
    assert (result.exit_code, result.stderr) == (0, "")
    assert f"held by the running worker of this bus (process {pid}), and was not touched" in result.stdout


@pytest.mark.parametrize(
    ("words", "is_its_worker"),
    [
        (["-m", "bus", "--bus", "dry-end"], True),
        (["lineside", "worker", "--bus=dry-end"], True),
        (["-m", "bus", "--bus", "wet-end"], False),
        (["lineside", "backup", "--bus", "dry-end"], False),
    ],
)
def test_a_worker_is_known_by_its_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], is_its_worker: bool
) -> None:
    monkeypatch.setattr(port_findings, "_PROC", tmp_path)
    (tmp_path / "7").mkdir()
    (tmp_path / "7" / "cmdline").write_text("\0".join(["python", *words, ""]))
    assert is_worker_of("dry-end", 7) is is_its_worker
    assert not is_worker_of("dry-end", 8)


def test_a_port_that_cannot_be_opened_is_a_fault(config: Path) -> None:
    result = run(config, bus("socket://127.0.0.1:1"))
    assert result.exit_code == 1
    assert "refuses the connection" in result.stderr


def test_an_absent_adapter_is_waited_for_as_without_a_trial(config: Path) -> None:
    result = run(config, bus("/dev/ttyUSB99"))
    assert (result.exit_code, result.stderr) == (0, "")
    assert "/dev/ttyUSB99 does not exist" in result.stdout


def test_a_locked_or_claimed_port_and_one_that_is_no_terminal_are_refused(terminal: tuple[int, str]) -> None:
    _, path = terminal
    with closing(open(path, "rb+", buffering=0)) as port:  # noqa: PTH123
        fcntl.flock(port, fcntl.LOCK_EX)
        refused = port_fault(path)
    assert refused is not None
    assert refused.code == "port_in_use"
    assert port_fault(path) is None
    no_terminal = port_fault("/dev/null")
    assert no_terminal is not None
    assert no_terminal.code == "port_not_serial"


def test_a_device_server_gets_one_connection_and_no_byte(config: Path, device_server: socket.socket) -> None:
    result = run(config, bus(url(device_server)))
    assert (result.exit_code, result.stderr) == (0, "")
    assert "accepts a connection, which was closed at once" in result.stdout
    connection, _ = device_server.accept()
    with connection:
        connection.settimeout(5.0)
        assert connection.recv(1) == b""
    assert has_no_caller(device_server)


def has_no_caller(server: socket.socket) -> bool:
    server.setblocking(False)
    try:
        server.accept()[0].close()
    except BlockingIOError:
        return True
    return False


def test_a_device_server_in_use_here_is_left_alone(config: Path, device_server: socket.socket) -> None:
    with socket.create_connection(device_server.getsockname()):
        device_server.accept()[0].close()
        assert is_connected_to(url(device_server)) is False, "the other end has closed it"
    with socket.create_connection(device_server.getsockname()):
        worker, _ = device_server.accept()
        with worker:
            result = run(config, bus(url(device_server)))
    assert (result.exit_code, result.stderr) == (0, "")
    assert "was not tried: a program of this machine is connected to it" in result.stdout
    assert has_no_caller(device_server)


def test_a_device_server_of_a_running_server_is_left_alone(
    config: Path, device_server: socket.socket
) -> None:
    lock = config.parent / "data" / LOCK_FILE
    lock.parent.mkdir()
    with lock.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        result = run(config, f"[server]\nport = {free_port()}\n{bus(url(device_server))}")
    assert (result.exit_code, result.stderr) == (0, "")
    assert "was not tried: the server runs" in result.stdout
    assert has_no_caller(device_server)
