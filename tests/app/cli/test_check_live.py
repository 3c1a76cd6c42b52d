"""``lineside check --live``: what the configuration names is tried, and a running Lineside is left alone."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import socket
import subprocess
import sys
import tempfile
import termios
import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from app.cli import check
from app.cli import check as live_findings
from app.cli import check as port_findings
from app.cli.check import is_connected_to, is_worker_of
from app.core.database import Database
from app.line.conditions import catalogue as of_server
from app.people.audit.entry import KeyOrigin
from app.people.audit.keys import make_key_file
from app.settings import LOCK_FILE
from bus.line.opener import port_fault
from tests.certificates import certificates
from tests.free_port import free_port


@contextmanager
def pseudo_terminal() -> Iterator[tuple[int, str]]:
    """The other end of a serial port, and its path."""
    master, slave = pty.openpty()
    path = os.ttyname(slave)
    os.close(slave)
    try:
        yield master, path
    finally:
        os.close(master)


def bus(port: str) -> str:
    """A bus with one unit."""
    return f'[[bus]]\nname = "dry-end"\nport = "{port}"\n[[bus.unit]]\nid = 1\nname = "Unwind"\n'


def run(config: Path, text: str, *words: str) -> Result:
    """Write the configuration, and check it."""
    config.write_text(text, encoding="utf-8")
    return check_live(config, *words)


def check_live(config: Path, *words: str) -> Result:
    """Check a configuration as it is."""
    return CliRunner().invoke(check.check, ["--live", "--config", str(config), *words])


def everything_in(folder: Path) -> dict[Path, tuple[int, int]]:
    """When each file was changed, and its size."""
    return {path: (path.stat().st_mtime_ns, path.stat().st_size) for path in (folder, *folder.rglob("*"))}


SERVICE = 4321
"""A user without a name."""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    return tmp_path / "lineside.toml"


@pytest.fixture
def terminal() -> Iterator[tuple[int, str]]:
    with pseudo_terminal() as made:
        yield made


# --- address -------------------------------------------------------------------------------------------


@contextmanager
def another_dashboard() -> Iterator[int]:
    class Healthy(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()
            self.wfile.write(b'{"status": "ok"}')

        def log_message(self, *_: object) -> None:
            """Quietly."""

    server = HTTPServer(("127.0.0.1", 0), Healthy)
    serving = threading.Thread(target=server.serve_forever)
    serving.start()
    yield server.server_port
    server.shutdown()
    serving.join()
    server.server_close()


def test_an_address_is_free_taken_or_of_another_lineside(config: Path, terminal: tuple[int, str]) -> None:
    text = bus(terminal[1])
    assert "is free" in run(config, f"[server]\nport = {free_port()}\n{text}").stdout
    with another_dashboard() as port:
        result = run(config, f"[server]\nport = {port}\n{text}")
    assert result.exit_code == 1
    assert f"http://127.0.0.1:{port} responds, and no server uses {config.parent / 'data'}" in result.stderr


def test_an_address_of_another_program_is_a_fault(
    config: Path, terminal: tuple[int, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_findings, "is_serving", lambda *_: False)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        text = f"[server]\nport = {taken.getsockname()[1]}\n{bus(terminal[1])}"
        result = run(config, text)
        assert (result.exit_code, "[server]: " in result.stderr) == (1, True)
        monkeypatch.setattr(live_findings, "is_locked", lambda _: True)
        assert "is in use by a server that does not respond" in run(config, text).stderr


# --- folders, certificates, store ----------------------------------------------------------------------


@pytest.fixture
def data(config: Path) -> Path:
    """The data folder of a site that was started once."""
    folder = config.parent / "data"
    Database(folder / "lineside.db").close()
    make_key_file(config.parent / "lineside.audit.key", KeyOrigin(0, "0" * 64))
    return folder


def test_folders_and_store_are_tried_and_left_as_they_are(
    config: Path, data: Path, terminal: tuple[int, str]
) -> None:
    (data / "configuration").mkdir()
    config.write_text(bus(terminal[1]))
    before = everything_in(config.parent)
    result = run(config, config.read_text(), "--json")
    assert result.exit_code == 0
    codes = [each["code"] for each in json.loads(result.stdout)["findings"]]
    assert codes.count("live_folder") == 3, "data, the folder in it, and that of the anchor"
    assert {"live_user", "live_store", "live_address_free", "live_port_opens"} <= set(codes)
    before.pop(config)
    assert before.items() <= everything_in(config.parent).items()


@pytest.mark.usefixtures("data")
def test_a_store_of_an_earlier_version_is_stated(
    config: Path, terminal: tuple[int, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_findings, "refuse_newer", lambda *_: [object(), object()])
    result = run(config, bus(terminal[1]))
    assert result.exit_code == 0
    assert "the next start brings them up to date, by 2 steps" in result.stdout


@contextmanager
def rights_of(user: int) -> Iterator[None]:
    groups = os.getgroups()
    os.setgroups([user])
    os.setresgid(user, user, 0)
    os.setresuid(user, user, 0)
    try:
        yield
    finally:
        os.setresuid(0, 0, 0)
        os.setresgid(0, 0, 0)
        os.setgroups(groups)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder away")
def test_root_tries_with_the_rights_of_the_service(monkeypatch: pytest.MonkeyPatch) -> None:
    with tempfile.TemporaryDirectory(prefix="lineside-live-") as name, ExitStack() as stack:
        folder = Path(name)
        folder.chmod(0o755)
        config, data = folder / "lineside.toml", folder / "data"
        text = f"[server]\nport = {free_port()}\n"
        run(config, text)  # what it imports, the service may be unable to read here
        data.mkdir()
        (data / "history.db").touch(0o600)
        os.chown(data, SERVICE, SERVICE)
        config.chmod(0o600)
        dropped: list[Path] = []

        def become(owner_of: Path) -> None:
            dropped.append(owner_of)
            stack.enter_context(rights_of(SERVICE))

        monkeypatch.setattr(check, "become_owner_of", become)
        monkeypatch.setenv("LOGNAME", "root")  # of who called it, by sudo
        result = check_live(config)
        assert (result.exit_code, dropped) == (1, [data])
        assert f"tried with the rights of user {SERVICE}" in result.stdout
        assert f"folder {data}: user {SERVICE} can write in it" in result.stdout
        assert f"{config}: user {SERVICE} may not read it" in result.stderr
        assert f"{data / 'history.db'}: user {SERVICE} may not read and write it" in result.stderr


@pytest.mark.parametrize(
    ("setting", "words", "code"),
    [
        ('certificate = "damaged.pem"\nkey = "server.key"\n', "damaged.pem", 1),
        ('certificate = "expired.pem"\nkey = "expired.key"\n', "expired.pem", 1),
        ('certificate = "server.pem"\nkey = "server.key"\nclient_ca = "worker-expired.pem"\n', "ended on", 1),
        ('certificate = "server.pem"\nkey = "server.key"\n', "does not exist", 0),
    ],
)
def test_a_fault_has_the_same_exit_code_without_a_trial(
    config: Path, setting: str, words: str, code: int
) -> None:
    """The last one is the port, which is waited for."""
    certificates(config.parent)
    (config.parent / "damaged.pem").write_text("-----BEGIN CERTIFICATE-----\nx\n")
    text = f"[server]\nport = {free_port()}\n[server.tls]\n{setting}{bus('/dev/ttyUSB99')}"
    tried = run(config, text)
    untried = CliRunner().invoke(check.check, ["--config", str(config)])
    assert (tried.exit_code, untried.exit_code) == (code, code), tried.output + untried.output
    assert words in tried.output
    assert code == 0 or words in untried.stderr


def test_each_certificate_has_its_days(
    config: Path, terminal: tuple[int, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    certificates(config.parent)
    (config.parent / "empty.pem").touch()
    webhook = '[[notify.webhook]]\nurl = "https://127.0.0.1:1/"\nsecret_file = "secret"\nca_file = '
    (config.parent / "secret").write_text("x" * 40)
    text = (
        f'[server]\nport = {free_port()}\n[server.tls]\ncertificate = "server.pem"\nkey = "server.key"\n'
        f'client_ca = "ca.pem"\n{bus(terminal[1])}{webhook}"expired.pem"\n{webhook}"empty.pem"\n'
    )
    result = run(config, text)
    assert result.exit_code == 1
    assert f"certificate {config.parent / 'server.pem'}: valid for" in result.stdout
    assert f"certificate {config.parent / 'ca.pem'}: valid for" in result.stdout
    assert f"certificate: the certificate {config.parent / 'expired.pem'} ended on" in result.stderr
    assert f"certificate: {config.parent / 'empty.pem'} holds no certificate" in result.stderr
    monkeypatch.setattr(of_server, "CERTIFICATE_S", 1e12)
    assert "more days only, until" in run(config, text).stdout


HOLD = "import os, sys; os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY); print(flush=True); sys.stdin.read()"


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
    monkeypatch.setattr("bus.line.opener.port_fault", lambda _: pytest.fail("opened"))
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
