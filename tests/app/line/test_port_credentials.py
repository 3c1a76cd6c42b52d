"""A port is shown on pages, so its URL holds no password: no command takes one, and none shows it."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest
from click.testing import CliRunner

from app.cli import cli

SECRET = "p/q's-3"
FAULTS = (
    f'port = "rfc2217://ann:{SECRET}@127.0.0.1:4001"',
    f'port = "socket://ann:{SECRET}@127.0.0.1:4001"',
    f'port = "rfc2217://ann:{SECRET}@127.0.0.1"',  # without its port number
    f'port = "rfc2217://ann:{SECRET}@127.0.0.1:4001',  # no TOML
)
COMMANDS = (
    ("serve",),
    ("worker", "--bus", "dry-end", "--app", "http://127.0.0.1:1", "--token", "t"),
    ("check", "--live"),
    ("check", "--json"),
    ("status",),
    ("status", "--json"),
    ("install-service", "--dry-run"),
    ("backup-store", "copy.tar"),
)


def printed(words: Sequence[str], code: int) -> str:
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == code, (words, done.output)
    return done.stdout + done.stderr


@pytest.mark.parametrize("fault", FAULTS)
def test_no_command_takes_a_port_with_a_password_and_none_shows_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    monkeypatch.chdir(tmp_path)
    config = tmp_path / "lineside.toml"
    config.write_text(f'[[bus]]\nname = "dry-end"\n{fault}\n')
    for words in COMMANDS if fault == FAULTS[0] else COMMANDS[:1]:
        text = printed([*words, "--config", str(config)], 1)
        assert f"{config}:3: " in text
        assert SECRET not in text
        assert "ann:" not in text
    printed(["support-bundle", "--out", "bundle.tar.gz", "--config", str(config)], 0)
    unpacked = subprocess.run(["tar", "-xzOf", tmp_path / "bundle.tar.gz"], capture_output=True, check=True)
    assert SECRET.encode() not in unpacked.stdout
    assert {each.name for each in tmp_path.iterdir()} == {"lineside.toml", "bundle.tar.gz"}


def test_a_scan_shows_no_password() -> None:
    text = printed(["scan", "--port", f"rfc2217://ann:{SECRET}@127.0.0.1:4001"], 2)
    assert "leave user and password out of the URL" in text
    assert SECRET not in text
