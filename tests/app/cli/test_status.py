"""``lineside status``: whether the dashboard serves, how its buses are, and what the files of a site hold."""

from __future__ import annotations

import json
import os
import ssl
import threading
from collections.abc import Callable
from contextlib import closing
from datetime import datetime
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from app.cli import cli, status
from app.cli.starting import url_of
from app.cli.status import backup_facts, certificate_facts, disk_facts
from app.core.database import Database
from app.core.database.connection import open_unchanged
from app.core.database.files import MIN_FREE_OF_OTHERS
from app.core.web.shape import iso
from app.line.history.series.runs import DAY, HOUR, micros
from app.line.history.status import MAX_DAYS, days_left, growth_of_history
from app.settings import load
from bus.instants import UnixTime, unix_now
from tests.app.history_line import NOON, Shelf, polls
from tests.certificates import certificates
from tests.for_each import for_each
from tests.free_port import free_port

MB = 1_000_000


@for_each(
    ("usable", "readings", "stored", "kept", "lasting", "days"),
    [
        (300, 10, 0, 30, 0, None),  # as much as will ever be stored
        (299, 10, 0, 30, 0, 29.9),
        (100, 10, 30, 30, 0, None),
        (100, 10, 30, 30, 1, 100),
        (100, 10, 25, 30, 1, 50),  # 55 until the retention, then 1 a day
        (100, 0, 0, 30, 0.01, None),
        (0, 10, 30, 30, 1, 0),
        (-50, 10, 10, 30, 0, 0),
    ],
)
def test_readings_grow_until_their_retention_and_the_rest_goes_on(
    usable: float, readings: float, stored: float, kept: int, lasting: float, days: float | None
) -> None:
    left = days_left(MIN_FREE_OF_OTHERS + int(usable * MB), readings * MB, stored, kept, lasting * MB)
    assert left == (None if days is None else pytest.approx(days))


@given(st.integers(0, 10**13), *[st.floats(0, 1e10)] * 2, st.integers(1, 3650), st.floats(0, 1e9))
def test_a_forecast_is_never_negative_and_more_space_lasts_longer(
    free: int, readings: float, stored: float, kept: int, lasting: float
) -> None:
    now, more = (days_left(each, readings, stored, kept, lasting) for each in (free, free + MB))
    assert now is None or now >= 0
    assert more is None or (now is not None and more >= now)


def test_the_growth_is_what_was_stored_of_late(tmp_path: Path) -> None:
    shelf = Shelf(tmp_path / "history.db")
    shelf.keep(polls(NOON, NOON + 120))
    shelf.fold()
    shelf.close()
    now = micros(UnixTime(NOON + 7200))
    with closing(open_unchanged(tmp_path / "history.db")) as connection:
        assert growth_of_history(connection, micros(UnixTime(NOON + 600))) is None
        [(size,)] = connection.execute("SELECT sum(length(data)) FROM raw")
        found = growth_of_history(connection, now)
        assert found is not None
        readings, _, stored = found
        assert stored == pytest.approx(2 * HOUR / DAY)
        assert readings == pytest.approx(size / stored)
        assert growth_of_history(connection, now + 30 * DAY) is None


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "lineside.toml"
    site = '[site]\nname = "Mill 7"\ntime_zone = "Europe/Berlin"\n'
    path.write_text(f'{site}[server]\nport = {free_port()}\ndata = "data"\n')
    Database(tmp_path / "data" / "lineside.db").close()
    return path


def test_stores_have_their_sizes_and_the_disk_its_space_and_with_history_a_forecast(config: Path) -> None:
    facts = disk_facts(load(config), unix_now()).shown
    assert facts["stores"] == {"lineside.db": (config.parent / "data" / "lineside.db").stat().st_size}
    assert facts["disk_free"] > 0
    assert facts["disk_days"] is None
    shelf = Shelf(config.parent / "data" / "history.db")
    shelf.keep(polls(NOON, NOON + 120))
    shelf.fold()
    shelf.close()
    days = disk_facts(load(config), UnixTime(NOON + 7200)).shown["disk_days"]
    assert days is not None
    assert 0 < days <= MAX_DAYS


def test_a_certificate_has_its_end_or_cannot_be_read(config: Path) -> None:
    certificates(config.parent)
    tls = '[server.tls]\ncertificate = "server.pem"\nkey = "server.key"\nclient_ca = "none.pem"\n'
    config.write_text(config.read_text() + tls)
    found = certificate_facts(load(config))
    ends = {Path(each["file"]).name: each["ends"] for each in found.shown["certificates"]}
    assert datetime.fromisoformat(ends["server.pem"]).timestamp() > unix_now()
    assert ends["none.pem"] is None
    assert [line.code for line in found.lines] == ["status_certificate", "status_certificate_unreadable"]


def test_backups_are_those_of_the_folder(config: Path) -> None:
    assert backup_facts(load(config), unix_now()).shown == {"backup": None}
    config.write_text(config.read_text() + '[backup]\nfolder = "copies"\nat = "02:30"\n')
    now = UnixTime(1_795_690_800.0)  # 2026-11-26, 12:00 at the site
    missing = backup_facts(load(config), now).shown["backup"]
    assert (missing["is_there"], missing["newest"], missing["next"]) == (False, None, iso(now))
    file = config.parent / "copies" / "lineside-2026-11-26-023000.tar"
    file.parent.mkdir()
    file.touch()
    os.utime(file, (float(now) - 34_200, float(now) - 34_200))
    found = backup_facts(load(config), now).shown["backup"]
    assert (found["newest"], found["next"]) == (iso(now - 34_200), iso(now + 52_200))


def test_one_screen_and_the_same_facts_as_json(config: Path) -> None:
    config.write_text(
        config.read_text() + '[backup]\nfolder = "copies"\n'
        '[[bus]]\nname = "dry-end"\nport = "/dev/ttyUSB0"\n[[bus.unit]]\nid = 1\nname = "Unwind"\n'
    )
    (config.parent / "copies").mkdir()
    shown = CliRunner().invoke(cli, ["status", "--config", str(config)])
    assert shown.exit_code == 1
    assert "lineside: no dashboard responds at http://127.0.0.1:" in shown.stderr
    lines = shown.stdout.splitlines()
    assert len(lines) < 20
    for text in (
        *("Mill 7: not serving, Lineside ", "  bus dry-end: 1 unit at /dev/ttyUSB0", "  lineside.db: 0."),
        *(" GB free; how long", "  backups: none yet in "),
    ):
        assert any(text in line for line in lines), text
    facts = json.loads(CliRunner().invoke(cli, ["status", "--config", str(config), "--json"]).stdout)
    assert (facts["serving"], facts["site"], facts["buses"]) == (False, "Mill 7", None)
    assert facts["configured"] == [{"name": "dry-end", "port": "/dev/ttyUSB0", "baud": 9600, "units": 1}]
    assert facts["stores"].keys() == {"lineside.db"}
    assert facts["disk_free"] > 0
    assert facts["backup"]["newest"] is None
    assert facts["version"]


@pytest.fixture
def served(tmp_path: Path) -> Path:
    number = free_port()
    path = tmp_path / "lineside.toml"
    path.write_text(f'[site]\nname = "Mill 7"\n[server]\nport = {number}\n')
    return path


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


def test_a_dashboard_that_serves(served: Path, play: Callable[[PlayedDashboard], None]) -> None:
    play(PlayedDashboard([], None))
    plain = CliRunner().invoke(cli, ["status", "--config", str(served)])
    assert plain.exit_code == 0
    assert plain.stdout.startswith("Mill 7: serving at http://127.0.0.1:")
    call = ["status", "--config", str(served), "--token", "secret"]
    result = CliRunner().invoke(cli, call)
    words = "bus dry-end: 1 of 2 units live, port closed: /dev/ttyUSB0 is not there"
    assert words in result.stdout
    assert "degraded" not in result.stdout
    printed = json.loads(CliRunner().invoke(cli, [*call, "--json"]).stdout)
    assert printed["buses"][0] == {**BUS, "units": 2, "units_online": 1, "scan_hz": None}
    assert printed["degraded"] == []


def test_faults_of_the_server_are_listed(served: Path, play: Callable[[PlayedDashboard], None]) -> None:
    play(PlayedDashboard(ALARMS, DISK_FULL))
    call = ["status", "--config", str(served), "--token", "secret"]
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


def test_a_server_that_read_its_certificate_before_the_file_was_damaged(served: Path) -> None:
    """It serves; the file is named, and the token is not sent to what cannot be verified."""
    certificates(served.parent)
    server = HTTPServer(("127.0.0.1", 0), responder(200, b'{"status":"ok"}'))
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(served.parent / "server.pem", served.parent / "server.key")
    server.socket = context.wrap_socket(server.socket, server_side=True)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    served.write_text(
        f"[server]\nport = {server.server_port}\n"
        '[server.tls]\ncertificate = "damaged.pem"\nkey = "server.key"\n'
    )
    (served.parent / "damaged.pem").write_text("-----BEGIN CERTIFICATE-----\nx\n")
    call = ["status", "--config", str(served), "--token", "secret"]
    try:
        result = CliRunner().invoke(cli, call)
        printed = json.loads(CliRunner().invoke(cli, [*call, "--json"]).stdout)
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
    assert result.exit_code == 0, result.output
    assert f"serving at https://127.0.0.1:{server.server_port}" in result.stdout
    assert f"degraded: {served.parent / 'damaged.pem'}" in result.stdout
    assert (printed["serving"], printed["buses"], len(printed["degraded"])) == (True, None, 1)


@for_each(
    ("code", "body", "serves"),
    [(200, b'{"status":"ok"}', True), (200, b"<html>", False), (404, b'{"status":"ok"}', False)],
)
def test_another_program_at_that_port_is_no_dashboard(code: int, body: bytes, serves: bool) -> None:
    with HTTPServer(("127.0.0.1", 0), responder(code, body)) as server:
        responding = threading.Thread(target=server.handle_request)
        responding.start()
        assert status.is_serving(f"http://127.0.0.1:{server.server_port}") is serves
        responding.join()


def test_where_it_is_found() -> None:
    for host in ("127.0.0.1", "0.0.0.0", "::"):
        assert url_of(host, 8000) == "http://127.0.0.1:8000"
    assert url_of("::1", 8000) == "http://[::1]:8000"
