"""``lineside status``: whether the dashboard of a configuration serves, and how its buses are."""

from __future__ import annotations

import json
import ssl
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
from click.testing import CliRunner

from app.cli import cli, status
from app.cli.serve import url_of
from tests.certificates import certificates
from tests.free_port import free_port


@pytest.fixture
def config(tmp_path: Path) -> Path:
    number = free_port()
    path = tmp_path / "lineside.toml"
    path.write_text(f'[site]\nname = "Mill 7"\n[server]\nport = {number}\n')
    return path


def test_a_dashboard_that_is_not_there(config: Path) -> None:
    result = CliRunner().invoke(cli, ["status", "--config", str(config)])
    assert (result.exit_code, result.stdout.splitlines()[0][:19]) == (1, "Mill 7: not serving")
    assert "lineside: no dashboard responds at http://127.0.0.1:" in result.stderr
    as_json = CliRunner().invoke(cli, ["status", "--config", str(config), "--json"])
    assert as_json.exit_code == 1
    assert json.loads(as_json.stdout)["serving"] is False


BUS = {
    "name": "dry-end",
    "worker": True,
    "link": "closed",
    "link_cause": {"code": "port_absent", "params": {}, "detail": "/dev/ttyUSB0 is not there"},
    "units": [{"link": "online"}, {"link": "stale"}],
}


def alarm(code: str, *, bus: str | None = None, active: bool = True) -> dict[str, object]:
    since, message = "2026-11-23T10:00:00.000Z", f"{code}. Check it."
    return {"code": code, "bus": bus, "active": active, "since": since, "message": message, "id": code}


ALARMS = [
    alarm("audit_degraded"),
    alarm("notification_failed", active=False),
    alarm("port_lost", bus="dry-end"),
]
DISK_FULL = {"code": "history_disk_full", "params": {}, "detail": "the disk is full"}


class PlayedDashboard:
    """A context like `app.cli.dashboard.dashboard`, with the responses of one."""

    def __init__(self, alarms: list[dict[str, object]], history: dict[str, object] | None) -> None:
        self._responses = {"/line": {"buses": [BUS], "history": history}, "/alarms": {"alarms": alarms}}

    def __enter__(self) -> PlayedDashboard:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is open."""

    def get(self, path: str) -> object:
        return self._responses[path]


@pytest.fixture
def play(monkeypatch: pytest.MonkeyPatch) -> Callable[[PlayedDashboard], None]:
    """Make a dashboard respond at the configured address, to the token ``secret``."""

    def play(played: PlayedDashboard) -> None:
        monkeypatch.setattr(status, "is_serving", lambda url, _own: url.startswith("http://127.0.0.1:"))
        monkeypatch.setattr(status, "dashboard", lambda _url, token, _own: {"secret": played}[token])

    return play


def test_a_dashboard_that_serves(config: Path, play: Callable[[PlayedDashboard], None]) -> None:
    play(PlayedDashboard([], None))
    plain = CliRunner().invoke(cli, ["status", "--config", str(config)])
    assert plain.exit_code == 0
    assert plain.stdout.startswith("Mill 7: serving at http://127.0.0.1:")
    call = ["status", "--config", str(config), "--token", "secret"]
    result = CliRunner().invoke(cli, call)
    words = "bus dry-end: 1 of 2 units live, port closed: /dev/ttyUSB0 is not there"
    assert words in result.stdout
    assert "degraded" not in result.stdout
    printed = json.loads(CliRunner().invoke(cli, [*call, "--json"]).stdout)
    assert printed["buses"][0] == {**BUS, "units": 2, "units_online": 1, "scan_hz": None}
    assert printed["degraded"] == []


def test_faults_of_the_server_are_listed(config: Path, play: Callable[[PlayedDashboard], None]) -> None:
    play(PlayedDashboard(ALARMS, DISK_FULL))
    call = ["status", "--config", str(config), "--token", "secret"]
    result = CliRunner().invoke(cli, call)
    assert result.exit_code == 0
    assert result.stdout.splitlines()[-2:] == [
        "  degraded: audit_degraded. Check it.",
        "  degraded: the disk is full",
    ]
    assert json.loads(CliRunner().invoke(cli, [*call, "--json"]).stdout)["degraded"] == [
        {
            "code": "audit_degraded",
            "since": "2026-11-23T10:00:00.000Z",
            "message": "audit_degraded. Check it.",
        },
        {"code": "history_disk_full", "since": None, "message": "the disk is full"},
    ]


def responder(code: int, body: bytes) -> type[BaseHTTPRequestHandler]:
    """A handler with one response."""

    class Responder(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(code)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            """Nothing is printed."""

    return Responder


def test_a_server_that_read_its_certificate_before_the_file_was_damaged(config: Path) -> None:
    """It serves; the file is named, and the token is not sent to what cannot be verified."""
    certificates(config.parent)
    server = HTTPServer(("127.0.0.1", 0), responder(200, b'{"status":"ok"}'))
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(config.parent / "server.pem", config.parent / "server.key")
    server.socket = context.wrap_socket(server.socket, server_side=True)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    config.write_text(
        f"[server]\nport = {server.server_port}\n"
        '[server.tls]\ncertificate = "damaged.pem"\nkey = "server.key"\n'
    )
    (config.parent / "damaged.pem").write_text("-----BEGIN CERTIFICATE-----\nx\n")
    call = ["status", "--config", str(config), "--token", "secret"]
    try:
        result = CliRunner().invoke(cli, call)
        printed = json.loads(CliRunner().invoke(cli, [*call, "--json"]).stdout)
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
    assert result.exit_code == 0, result.output
    assert f"serving at https://127.0.0.1:{server.server_port}" in result.stdout
    assert f"degraded: {config.parent / 'damaged.pem'}" in result.stdout
    assert (printed["serving"], printed["buses"], len(printed["degraded"])) == (True, None, 1)


@pytest.mark.parametrize(
    ("code", "body", "serves"),
    [(200, b'{"status":"ok"}', True), (200, b"<html>", False), (404, b'{"status":"ok"}', False)],
)
def test_another_program_at_that_port_is_no_dashboard(code: int, body: bytes, serves: bool) -> None:
    with HTTPServer(("127.0.0.1", 0), responder(code, body)) as server:
        responding = threading.Thread(target=server.handle_request)
        responding.start()
        assert status.is_serving(f"http://127.0.0.1:{server.server_port}") is serves
        responding.join()


@pytest.mark.parametrize(
    ("host", "url"),
    [
        ("127.0.0.1", "http://127.0.0.1:8000"),
        ("0.0.0.0", "http://127.0.0.1:8000"),
        ("::", "http://127.0.0.1:8000"),
        ("::1", "http://[::1]:8000"),
    ],
)
def test_where_it_is_found(host: str, url: str) -> None:
    assert url_of(host, 8000) == url
