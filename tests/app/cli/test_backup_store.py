"""``lineside backup-store`` and ``restore-store``."""

from __future__ import annotations

import json
import sqlite3
import tarfile
from pathlib import Path

import pytest
from click.testing import CliRunner

from app.cli import cli
from app.cli.audit import proof_of
from app.cli.findings import Finding, archive
from app.core.database import Database
from app.errors import StoreError
from app.settings import Settings, load
from bus.messages import Message
from tests.app.archived_site import archived_site
from tests.app.backups import read_backup, write_backup
from tests.app.history_line import BUS, NOON, Shelf, opened, polls, until


@pytest.fixture
async def site(tmp_path: Path) -> Settings:
    """Five months of events, of which the first three are archived."""
    return await archived_site(tmp_path)


def verified(settings: Settings, archive: Path | None = None) -> list[str]:
    return [str(line) for line in proof_of(settings, None, archive)]


async def test_verify_follows_the_chains_through_the_archive(site: Settings, tmp_path: Path) -> None:
    complete, *_ = lines = verified(site)
    assert complete == "the audit log is intact: 13 entries"
    assert "the archive is intact: 6 of these entries" in lines
    elsewhere = (tmp_path / "archive").rename(tmp_path / "safe")
    assert any("events-2026-01.jsonl.gz" in line and "not verified" in line for line in verified(site))
    assert "the archive is intact: 6 of these entries" in verified(site, elsewhere)


async def test_verify_names_a_damaged_file(site: Settings, tmp_path: Path) -> None:
    (tmp_path / "archive" / "events-2026-02.jsonl.gz").write_bytes(b"damaged")
    with pytest.raises(StoreError, match="events-2026-02"):
        verified(site)


def test_check_names_a_folder_that_is_not_there(tmp_path: Path) -> None:
    file = tmp_path / "lineside.toml"
    file.write_text('[audit]\narchive = "archive"\n')
    folder = tmp_path / "archive"
    missing = Message.of("audit_archive_folder_missing", folder=str(folder))
    assert Finding(missing, is_fault=True) in list(archive(load(file)))
    folder.mkdir()
    assert Finding(Message.of("check_archive", folder=str(folder))) in list(archive(load(file)))


def keys_in(folder: Path) -> list[Path]:
    return [folder / "lineside.audit.key"]


def seen(data: Path) -> int:
    shelf = Shelf(data / "history.db")
    count = len(shelf.query("actual", NOON, NOON + 60).series.at)
    shelf.close()
    return count


def test_a_copy_taken_while_it_is_written_holds_what_was_there(tmp_path: Path) -> None:
    data = tmp_path / "data"
    data.mkdir()
    Database(data / "lineside.db").close()
    writer = opened(data)
    writer.enqueue((BUS.name, polls(NOON, NOON + 30)))
    until(lambda: writer.status.waiting == 0)
    assert write_backup(data, tmp_path / "one.tar").stores == ["history.db", "lineside.db"]
    writer.enqueue((BUS.name, polls(NOON + 30, NOON + 60)))
    writer.close()
    assert seen(data) == 300
    for into in (data, tmp_path / "elsewhere"):
        names = read_backup(tmp_path / "one.tar", into, keys_in(tmp_path)).names
        assert (names, seen(into)) == (["history.db", "lineside.db"], 150)
    assert (data / "history.db.before-restore").exists()


def test_an_open_store_is_not_replaced(tmp_path: Path) -> None:
    writer = opened(tmp_path)
    write_backup(tmp_path, tmp_path / "one.tar")
    with pytest.raises(StoreError, match="in use"):
        read_backup(tmp_path / "one.tar", tmp_path, keys_in(tmp_path))
    writer.close()
    assert not (tmp_path / "history.db.before-restore").exists()
    read_backup(tmp_path / "one.tar", tmp_path, keys_in(tmp_path))


def test_a_damaged_backup_changes_nothing(tmp_path: Path) -> None:
    data = tmp_path / "data"
    shelf = Shelf(data / "history.db")
    shelf.keep(polls(NOON, NOON + 10))
    shelf.close()
    backup = tmp_path / "one.tar"
    write_backup(data, backup)
    content = backup.read_bytes()
    with tarfile.open(tmp_path / "unsound.tar", "w") as archive:
        (tmp_path / "manifest.json").write_text(json.dumps({"nothing": 1}))
        archive.add(tmp_path / "manifest.json", "manifest.json")
    for damaged in (
        content[: len(content) // 2],
        b"something else " * 1000,
        content.replace(b"SQLite format 3", b"sqlite format 3"),
        (tmp_path / "unsound.tar").read_bytes(),
    ):
        backup.write_bytes(damaged)
        with pytest.raises(StoreError):
            read_backup(backup, data, keys_in(tmp_path))
        assert seen(data) == 50


def test_the_commands_print_one_line(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="no store"):
        write_backup(tmp_path / "empty", tmp_path / "two.tar")
    config = tmp_path / "lineside.toml"
    config.write_text('[site]\nname = "Test"\n[server]\ndata = "data"\n')
    Database(tmp_path / "data" / "lineside.db").close()
    run = CliRunner().invoke
    backup = str(tmp_path / "one.tar")
    assert run(cli, ["backup-store", backup, "--config", str(config)]).exit_code == 0
    again = run(cli, ["backup-store", backup, "--config", str(config)])
    assert (again.exit_code, "exists already" in again.stderr) == (1, True)
    assert run(cli, ["restore-store", backup, "--config", str(config)], input="n\n").exit_code == 1
    piped = run(cli, ["restore-store", backup, "--config", str(config)], input="")
    assert (piped.exit_code, "--help" in piped.stderr) == (2, True)
    absent = run(cli, ["restore-store", backup + "x", "--config", str(config)], input="y\n")
    assert (absent.exit_code, "Replace" in absent.stdout) == (1, False)
    restored = run(cli, ["restore-store", backup, "--config", str(config), "--yes"])
    assert restored.exit_code == 0, restored.stderr
    with sqlite3.connect(tmp_path / "data" / "lineside.db") as connection:
        assert connection.execute("SELECT kind FROM events").fetchall() == [("server",)]


@pytest.mark.parametrize("keep", [False, True])
def test_it_lists_the_tokens_that_it_will_revoke_before_it_begins(tmp_path: Path, keep: bool) -> None:
    config, backup = tmp_path / "lineside.toml", tmp_path / "one.tar"
    config.write_text('[server]\ndata = "data"\n')

    def run(*words: object, text: str = "") -> str:
        done = CliRunner().invoke(cli, [*map(str, words), "--config", str(config)], input=text)
        return f"{done.exit_code} {done.output}"

    password = "collect house bakery stable\n"
    assert run("user", "add", "anna", "--role", "admin", "--password-stdin", text=password).startswith("0 ")
    for name in ("plc", "prometheus", "scada"):
        assert run("token", "create", name, "--role", "viewer").startswith("0 ")
    assert run("backup-store", backup).startswith("0 ")
    for name in ("plc", "scada"):
        assert run("token", "revoke", name).startswith("0 ")
    option = ["--keep-tokens"] if keep else []
    asked = run("restore-store", backup, *option, text="n\n")
    assert asked.startswith("1 ")
    assert ("will be revoked: plc, scada." in asked.partition("Replace the stores")[0]) is not keep
    assert "plc" not in run("token", "list"), "nothing was replaced"
    assert run("restore-store", backup, *option, text="y\n").startswith("0 ")
    left = [line.split("\t")[0] for line in run("token", "list")[2:].splitlines()]
    assert left == (["plc", "prometheus", "scada"] if keep else ["prometheus"])
