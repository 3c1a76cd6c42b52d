"""The commands that use a dashboard: which server they trust, with which token, and what they print."""

from __future__ import annotations

import json
import os
import shutil
import ssl
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import certifi
import pytest
from click.testing import CliRunner, Result

from app.cli import cli
from app.cli.dashboard import trusted_authorities
from bus.errors import CallerError

LINE = {"buses": [{"name": "dry-end", "units": [{"id": 1, "name": "Unwind"}]}]}
FILE = """\
format = "lineside parameter set"
version = 1
taken_at = 2026-11-22T03:00:00Z
[[unit]]
id = 1
[unit.parameters]
6 = { raw = 50 }
20 = { raw = 1216 }
"""


class PlayedDashboard(HTTPServer):
    """Responds to each path with its entry in ``responses``; keeps the headers and bodies that it
    received.
    """

    def __init__(self, certificate: Path | None = None) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.responses: dict[str, Any] = {"/api/v1/line": LINE}
        self.tokens: list[str | None] = []
        self.bodies: list[Any] = []
        self.url = f"http://127.0.0.1:{self.server_port}"
        if certificate is not None:
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            context.load_cert_chain(certificate)
            self.socket = context.wrap_socket(self.socket, server_side=True)
            self.url = f"https://127.0.0.1:{self.server_port}"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that does not trust the certificate hangs up."""
        assert request
        assert client_address


class _Handler(BaseHTTPRequestHandler):
    server: PlayedDashboard

    def do_GET(self) -> None:
        self.server.tokens.append(self.headers["Authorization"])
        body = json.dumps(self.server.responses[self.path.partition("?")[0]]).encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def do_POST(self) -> None:
        self.server.bodies.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
        self.do_GET()

    def log_message(self, *_: Any) -> None:
        """Nothing on standard error."""


@contextmanager
def serving(certificate: Path | None = None) -> Iterator[PlayedDashboard]:
    server = PlayedDashboard(certificate)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.fixture(autouse=True)
def bare(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("LINESIDE_TOKEN", "LINESIDE_URL", "SSL_CERT_FILE", "SSL_CERT_DIR"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    made = tmp_path / "unit1.toml"
    made.write_text(FILE)
    return made


@pytest.fixture
def own_authority(tmp_path: Path) -> Path:
    """A certificate that signs itself, with its key, for 127.0.0.1."""
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("openssl makes the certificate, and is not here")
    made = tmp_path / "plant.pem"
    names = ("-subj", "/CN=plant", "-addext", "subjectAltName=IP:127.0.0.1")
    kind = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2")
    subprocess.run(
        [openssl, "req", "-x509", *kind, *names, "-keyout", str(made), "-out", str(tmp_path / "cert")],
        check=True,
        capture_output=True,
    )
    made.write_text(made.read_text() + (tmp_path / "cert").read_text())
    return made


def backup(url: str, *more: str) -> Result:
    """Back up an unknown bus, up to the dashboard's response."""
    return CliRunner().invoke(cli, ["backup", "--url", url, "--bus", "nix", "--out", "x.toml", *more])


def test_the_plant_has_a_private_certificate_authority(
    own_authority: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with serving(own_authority) as server:
        stranger = backup(server.url, "--token", "t")
        assert (stranger.exit_code, server.tokens) == (1, [])
        assert "name the certificate of its authority in SSL_CERT_FILE" in stranger.stderr
        monkeypatch.setenv("SSL_CERT_FILE", str(own_authority))
        known = backup(server.url, "--token", "t")
    assert (known.exit_code, server.tokens) == (2, ["Bearer t"])
    assert "there is no bus 'nix'; this dashboard has dry-end" in known.stderr


def test_named_authorities_are_the_only_ones(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    every = Path(certifi.where()).read_text()
    one = tmp_path / "one.pem"
    one.write_text(every[: every.index("-----END CERTIFICATE-----")] + "-----END CERTIFICATE-----\n")
    assert trusted_authorities().cert_store_stats()["x509_ca"] > 50
    monkeypatch.setenv("SSL_CERT_FILE", str(one))
    assert trusted_authorities().cert_store_stats()["x509_ca"] == 1


@pytest.mark.parametrize(("text", "why"), [(None, "No such file"), ("nothing", "it holds no certificate")])
def test_a_file_without_certificates_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str | None, why: str
) -> None:
    file = tmp_path / "wrong.pem"
    if text is not None:
        file.write_text(text)
    monkeypatch.setenv("SSL_CERT_FILE", str(file))
    with pytest.raises(CallerError, match=f"SSL_CERT_FILE .*wrong.pem' cannot be used: {why}"):
        trusted_authorities()


def calls(url: str, file: Path) -> list[list[str]]:
    """Each command that takes a token, as far as it needs one."""
    to = ["--url", url, "--bus", "dry-end", "--unit", "1"]
    out = str(file.with_name("out.toml"))
    return [["backup", *to, "--out", out], ["diff", *to, str(file)], ["restore", *to, str(file)]]


def test_each_command_takes_its_token_from_a_file_or_the_environment(
    tmp_path: Path, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    secret = tmp_path / "token"
    secret.write_text("of-file\n")
    secret.chmod(0o600)
    run: Callable[..., Result] = CliRunner().invoke
    with serving() as server:
        for call in calls(server.url, file):
            none = run(cli, call)
            assert (none.exit_code, "there is no token" in none.stderr) == (2, True)
            run(cli, [*call, "--token-file", str(secret)])
        assert set(server.tokens) == {"Bearer of-file"}
        monkeypatch.setenv("LINESIDE_TOKEN", "of-environment")
        run(cli, call)
        assert server.tokens[-1] == "Bearer of-environment"
        run(cli, [*call, "--token", "of-option"])
        assert server.tokens[-1] == "Bearer of-option"


def test_a_backup_replaces_nothing_that_is_there(tmp_path: Path) -> None:
    """As root, ``--out /dev/null`` made a file of it."""
    for number, make in enumerate((Path.touch, os.mkfifo, partial(os.symlink, "/dev/null"))):
        out = tmp_path / str(number)
        make(out)
        before = out.lstat()
        done = backup("http://127.0.0.1:1", "--token", "t", "--out", str(out))
        assert (done.exit_code, "exists already" in done.stderr) == (2, True)
        assert (out.lstat().st_mode, out.lstat().st_ino) == (before.st_mode, before.st_ino)


def text(detail: str) -> dict[str, Any]:
    return {"code": "differs", "params": {}, "detail": detail}


def row(number: int, name: str, **more: Any) -> dict[str, Any]:
    values = {"present": text("10.0 s"), "wanted": text("5.0 s"), "present_raw": 100, "wanted_raw": 50}
    plain = {
        "reason": None,
        "warning": None,
        "outcome": None,
        "message": None,
        "meaning": text("5.0 s instead of 10.0 s"),
    }
    return {"number": number, "name": name, "selected": True, **values, **plain, **more}


def left_out(number: int, name: str, **more: Any) -> dict[str, Any]:
    return {**row(number, name), "later": False, "differs": True, **more}


PLAN = {
    "id": "r1",
    "state": "planned",
    "cause": None,
    "equal": 38,
    "remarks": [text("the unit runs")],
    "rows": [
        row(6, "Acceleration Ramp Rate", warning=text("Changes how fast it is")),
        row(20, "Speed Setpoint", selected=False, reason=text("Changes the machine's speed now")),
    ],
    "left_out": [
        left_out(20, "Speed Setpoint", reason=text("Changes the machine's speed now")),
        left_out(21, "Operator Password", reason=text("secret, not stored in the set"), differs=None),
    ],
}


def restore(file: Path, *more: str, ended: dict[str, Any] | None = None) -> tuple[Result, list[Any]]:
    end = {**PLAN, "state": "equal", "rows": [row(6, "Acceleration Ramp Rate", outcome="verified")]}
    with serving() as server:
        server.responses |= {
            "/api/v1/buses/dry-end/units/1/restores": PLAN,
            "/api/v1/restores/r1/start": PLAN,
            "/api/v1/restores/r1": end | (ended or {}),
        }
        call = calls(server.url, file)[2]
        return CliRunner().invoke(cli, [*call, "--token", "t", *more]), server.bodies


def test_a_restore_names_what_it_leaves_out(file: Path) -> None:
    done, bodies = restore(file, "--yes")
    assert done.exit_code == 0
    assert bodies[0]["include"] == bodies[0]["exclude"] == bodies[0]["ticked"] == []
    lines = done.stdout.splitlines()
    assert lines[:2] == ["note: the unit runs", "1 row to write, 38 equal"]
    assert lines[2].endswith("5.0 s instead of 10.0 s  (Changes how fast it is)")
    assert lines[3].startswith("#20 Speed Setpoint")
    assert lines[3].endswith("left out: 10.0 s → 5.0 s  Changes the machine's speed now")
    assert "#21 Operator Password               left out: secret, not stored in the set" in lines
    assert "1 of 1 row verified; complete read-back: equal" in lines
    assert lines[-1] == lines[3]


def test_the_rows_are_chosen_by_number(file: Path) -> None:
    _, bodies = restore(file, "--yes", "--include", "20", "--exclude", "6", "--exclude", "7", "--tick", "18")
    assert {key: bodies[0][key] for key in ("include", "exclude", "ticked")} == {
        "include": [20],
        "exclude": [6, 7],
        "ticked": [18],
    }


def test_the_result_for_programs_has_the_rows_left_out_too(file: Path) -> None:
    done, _ = restore(file, "--yes", "--json")
    rows = json.loads(done.stdout)
    assert [(each["number"], each["outcome"]) for each in rows] == [(6, "verified"), (20, "left_out")]
    assert rows[1]["message"]["detail"] == "Changes the machine's speed now"


def test_what_still_differs_is_named(file: Path) -> None:
    remaining = [{"number": number} for number in (6, 7)]
    done, _ = restore(file, "--yes", ended={"state": "different", "remaining": remaining})
    words = "Acceleration Ramp Rate (parameter 6), Deceleration Ramp Rate (parameter 7) differ;"
    assert (done.exit_code, words in done.stderr) == (1, True)


def test_two_files_that_differ(tmp_path: Path, file: Path) -> None:
    other = tmp_path / "other.toml"
    other.write_text(FILE.replace("raw = 50", "raw = 51").replace("1216", "1134"))
    done = CliRunner().invoke(cli, ["diff", str(file), str(other)])
    assert (done.exit_code, done.stdout.splitlines()[0]) == (1, "2 rows differ (file, then now):")


@pytest.mark.parametrize(("raw", "differing"), [(50, []), (51, [(1, 6)])])
def test_a_unit_in_one_file_only_is_a_difference(
    tmp_path: Path, file: Path, raw: int, differing: list[tuple[int, int]]
) -> None:
    other = tmp_path / "both.toml"
    other.write_text(
        FILE.replace("raw = 50", f"raw = {raw}") + FILE[FILE.index("[[unit]]") :].replace("id = 1", "id = 2")
    )
    for order in ([file, other], [other, file]):
        done = CliRunner().invoke(cli, ["diff", "--json", *map(str, order)])
        assert [(row["unit"], row["number"]) for row in json.loads(done.stdout)] == differing
        assert (done.exit_code, done.stderr) == (1, "unit 2 is in one of the files only\n")
        assert "equal" not in CliRunner().invoke(cli, ["diff", *map(str, order)]).stdout
