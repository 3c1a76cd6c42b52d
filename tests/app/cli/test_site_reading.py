"""Commands that only read: they make and change nothing, also of a copy whose log was not taken into its
store."""

from __future__ import annotations

import json
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from app.cli import cli
from app.core.database.connection import open_unchanged
from tests.e2e.site import add_people
from tests.mounted import mounted

READING = (("user", "list"), ("token", "list"), ("audit", "verify"), ("check",), ("status",), ("report",))
BEGUN = '[site]\nname = "Mill"\n[server]\nport = 1\ndata = "./data"\n'
BUS = '[[bus]]\nname = "dry-end"\nport = "/dev/ttyUSB99"\n'


def state(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Time and content of each file."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {str(path.relative_to(folder)): (path.stat().st_mtime_ns, path.read_bytes()) for path in files}


def run(words: tuple[str, ...], config: Path, *more: str) -> Result:
    return CliRunner().invoke(cli, [*words, "--config", str(config), *more])


@pytest.fixture
def site(tmp_path: Path) -> Path:
    config = tmp_path / "site" / "lineside.toml"
    config.parent.mkdir()
    config.write_text(BEGUN + BUS)
    add_people(config)
    return config


@pytest.fixture
def copied(site: Path, tmp_path: Path) -> Path:
    """A copy of the files of a site that runs: the newest rows are in the log of its store, which has no
    index."""
    with closing(sqlite3.connect(site.parent / "data" / "lineside.db", isolation_level=None)) as connection:
        connection.execute("PRAGMA wal_autocheckpoint = 0")
        connection.execute("UPDATE users SET role = 'viewer' WHERE name = 'operator'")
        copy = tmp_path / "copy"
        shutil.copytree(site.parent, copy, ignore=shutil.ignore_patterns("*-shm"))
    assert (copy / "data" / "lineside.db-wal").stat().st_size
    return copy / "lineside.toml"


def test_a_command_that_reads_makes_and_changes_nothing(site: Path, copied: Path) -> None:
    for config in (site, copied):
        before = state(config.parent)
        for words in READING:
            done = run(words, config)
            assert state(config.parent) == before, words
            assert done.exit_code == 0 or words in (("check",), ("status",)), done.stderr
    assert "operator\tviewer" in run(("user", "list"), copied).stdout


def test_a_copy_on_a_read_only_disk_is_read(copied: Path, tmp_path: Path) -> None:
    place = tmp_path / "disk"
    place.mkdir()
    with mounted("--bind", "-o", "ro", str(copied.parent), at=place):
        for words in (each for each in READING if each not in (("check",), ("status",))):
            done = run(words, place / "lineside.toml")
            assert done.exit_code == 0, done.stderr
        assert "operator\tviewer" in run(("user", "list"), place / "lineside.toml").stdout


def test_a_store_that_is_read_cannot_be_written(copied: Path) -> None:
    connection = open_unchanged(copied.parent / "data" / "lineside.db")
    with closing(connection), pytest.raises(sqlite3.OperationalError):
        connection.execute("DELETE FROM users")


def test_without_a_store_none_is_made(tmp_path: Path) -> None:
    config = tmp_path / "lineside.toml"
    config.write_text(BEGUN)
    for words in (("user", "list"), ("token", "list"), ("audit", "verify")):
        done = run(words, config)
        assert (done.exit_code, "there is no store" in done.stderr) == (1, True)
    assert [path.name for path in tmp_path.iterdir()] == ["lineside.toml"]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ("INSERT INTO migrations VALUES (9999, 'of_tomorrow', 0)", "newer version"),
        ("DELETE FROM migrations WHERE number = (SELECT max(number) FROM migrations)", "earlier version"),
    ],
)
def test_a_store_of_another_version_is_named_as_such(site: Path, change: str, text: str) -> None:
    with closing(sqlite3.connect(site.parent / "data" / "lineside.db", isolation_level=None)) as connection:
        connection.execute(change)
    done = run(("user", "list"), site)
    assert (done.exit_code, text in done.stderr) == (1, True)
    assert (text in run(("check",), site).stderr) is ("newer" in text)


def test_lists_are_json_too(site: Path) -> None:
    users = json.loads(run(("user", "list"), site, "--json").stdout)["users"]
    assert {
        "name": "operator",
        "role": "operator",
        "panel": False,
        "company_account": False,
        "disabled": False,
    } in users
    [token, *_] = json.loads(run(("token", "list"), site, "--json").stdout)["tokens"]
    assert token.keys() == {"name", "role", "created_by", "bus", "last_day"}
    proof = json.loads(run(("audit", "verify"), site, "--json").stdout)
    assert (proof["intact"], proof["messages"][0]["code"]) == (True, "audit_whole")
    findings = json.loads(run(("check",), site, "--json").stdout)["findings"]
    assert "check_bus_absent" in {finding["code"] for finding in findings}
