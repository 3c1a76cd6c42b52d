"""The bundle has what helps, and none of the secrets that a site has in any of its places."""

from __future__ import annotations

import io
import json
import tarfile
from pathlib import Path

import pytest
from click.testing import CliRunner

from app.cli import cli
from app.cli.support_bundle import bundle, parts
from tests.e2e.site import PASSWORD, add_people
from tests.for_each import for_each

SECRETS = ("mail-secret-1", "hook-path-2", "hook-secret-3")
MIN_KEY = 32
CONFIGURATION = """\
[site]
name = "Paper machine 2"
[server]
data = "./data"
[notify.smtp]
host = "mail.example"
sender = "lineside@plant.example"
to = ["duty@plant.example"]
user = "lineside"
password_file = "mail.password"
security = "starttls"
[[notify.webhook]]
url = "https://hooks.example/hook-path-2"
secret_file = "hook.key"
[[bus]]
name = "dry-end"
port = "/dev/ttyUSB0"
[[bus.unit]]
id = 1
name = "Unwind"
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    (tmp_path / "mail.password").write_text("mail-secret-1\n")
    (tmp_path / "hook.key").write_text("hook-secret-3\n")
    config = tmp_path / "lineside.toml"
    config.write_text(CONFIGURATION)
    return config


def contents(packed: bytes) -> dict[str, str]:
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        return {
            entry.name.removeprefix("lineside-support/"): archive.extractfile(entry).read().decode()  # type: ignore[union-attr]
            for entry in archive
        }


def test_it_has_no_secret_of_any_place(config: Path) -> None:
    tokens = add_people(config)
    key_file = (config.parent / "lineside.audit.key").read_text()
    keys = [word for word in key_file.replace('"', " ").split() if len(word) >= MIN_KEY]
    assert keys
    found = contents(bundle(parts(config)))
    assert list(found) == [
        *("about.json", "configuration.json", "findings.txt", "files.json", "events.json", "log.txt")
    ]
    complete = "\n".join(found.values())
    assert "Paper machine 2" in complete
    assert [secret for secret in (*SECRETS, PASSWORD, *keys, *tokens.values()) if secret in complete] == []
    assert "$argon2" not in complete
    events = json.loads(found["events.json"])
    assert {event["kind"] for event in events} >= {"user"}
    assert all(set(event) == {"id", "time", "kind", "bus", "unit", "what", "outcome"} for event in events)
    assert json.loads(found["files.json"])["files"]["lineside.db"] > 0
    assert json.loads(found["about.json"])["packages"]["fastapi"]


@for_each(
    ("text", "place"),
    [
        ('[site]\npassword = "mail-secret-1\n', ":2: this is not TOML"),
        ('[[bus]]\nname = "dry-end"\nport = "ftp://user:mail-secret-1@host"\n', ":3: bus.port = …"),
        ("[server]\npasword = 'mail-secret-1'\n", "pasword"),
    ],
)
def test_the_text_at_a_fault_of_the_configuration_is_left_out(config: Path, text: str, place: str) -> None:
    config.write_text(text)
    found = contents(bundle(parts(config)))
    assert place in found["configuration.txt"]
    assert "mail-secret-1" not in "\n".join(found.values())


def test_a_url_has_neither_user_nor_password_in_any_part() -> None:
    line = b"cannot open 'socket://cabinet:port@secret-5@host'\n"
    assert contents(bundle([("log.txt", line)])) == {"log.txt": "cannot open 'socket://…@host'\n"}


def test_the_command_writes_a_private_file_and_no_other_and_overwrites_none(config: Path) -> None:
    out = config.parent / "support.tar.gz"
    call = ["support-bundle", "--config", str(config), "--out", str(out)]
    done = CliRunner().invoke(cli, call)
    assert (done.exit_code, str(out) in done.stdout) == (0, True), done.stderr
    assert out.stat().st_mode & 0o077 == 0
    assert not (config.parent / "data").exists(), "reading makes nothing"
    before = out.read_bytes()
    assert (CliRunner().invoke(cli, call).exit_code, out.read_bytes()) == (1, before)
