"""``lineside check --live``: what the configuration names is tried, without a trace."""

from __future__ import annotations

import json
import os
import socket
import tempfile
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
from click.testing import CliRunner

from app.cli import check
from app.cli import check_live as live_findings
from app.core.database import Database
from app.line.conditions import catalogue as of_server
from app.people.audit.chain import KeyOrigin
from app.people.audit.keys import make_key_file
from tests.app.live_check import bus, check_live, everything_in, pseudo_terminal, run
from tests.certificates import certificates
from tests.free_port import free_port

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
