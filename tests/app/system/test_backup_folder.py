"""A folder of backups: each restores the site as it was, writes only what is new, and shares the rest; what
is damaged, unfinished or of another site is never taken for a backup."""

from __future__ import annotations

import asyncio
import json
import os
import random
import re
import shutil
import sqlite3
import subprocess
import sys
import tarfile
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from app.cli import cli
from app.core.database import Database, StoreConnection
from app.errors import StoreError
from app.line.history import tables
from app.line.history.series.runs import MINUTE, micros
from app.people.audit.log import EventLog
from app.records.handover.notes import MIGRATIONS as PICTURES
from app.settings import Settings, load
from app.system.backup.archive import KEPT_EVENTS, WrittenBackup
from app.system.backup.folder import CONTENTS, REMOVE_EVERY, SITE, name_of, open_newest, write_to_folder
from app.system.backup.stores import CHANGED, copy_store
from bus.instants import UnixTime
from tests import fork_server
from tests.app.archived_site import archived_site
from tests.app.busy_site import make_site
from tests.app.cli.test_backup_store import verified
from tests.app.fake_worker import until
from tests.app.history_line import NOON, Shelf, polls
from tests.app.plant_database import keep, published, publishing, reading
from tests.app.plant_database import rows as published_rows
from tests.mounted import mounted
from tests.postgresql import fresh_database, needs_postgresql
from tests.sizes import sizes

HOUR = 3600.0
STORES = ("history.db", "pictures.db", "lineside.db")


class Plant:
    """A site that is written by the test, and its backups."""

    def __init__(self, folder: Path, keep: str = "") -> None:
        self.folder, self.backups = folder, folder / "backups"
        self.backups.mkdir()
        self.config = folder / "lineside.toml"
        self.config.write_text(f'[server]\ndata = "data"\n[backup]\nfolder = "backups"\n{keep}')
        self.settings = load(self.config)
        data = self.settings.server.data
        self.main = Database(data / "lineside.db")
        self.pictures = Database(data / "pictures.db", PICTURES)
        self.shelf = Shelf(data / "history.db")

    def picture(self, digest: str) -> None:
        row = (digest, "image/png", digest.encode() * 1000)
        self.pictures.write_now(lambda c: c.execute("INSERT INTO picture VALUES (?, ?, ?)", row))

    def back_up(self, at: float) -> WrittenBackup:
        return write_to_folder(self.settings, self.backups, UnixTime(at))

    def rows(self) -> dict[str, list[tuple[Any, ...]]]:
        return rows_of(self.settings.server.data)

    def close(self) -> None:
        for database in (self.main, self.pictures, self.shelf.database):
            database.close()


@pytest.fixture
def plant(tmp_path: Path) -> Plant:
    return Plant(tmp_path)


def rows_of(data: Path) -> dict[str, list[tuple[Any, ...]]]:
    """Every row of history and pictures, which are sound, with the definition of their tables."""
    found: dict[str, list[tuple[Any, ...]]] = {}
    for name in STORES[:2]:
        with closing(sqlite3.connect(data / name)) as store:
            assert store.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
            found[name] = sorted(store.execute("SELECT name, sql FROM sqlite_master").fetchall(), key=str)
            for (table,) in store.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall():
                if table == CHANGED:
                    continue
                found[f"{name} {table}"] = sorted(store.execute(f"SELECT * FROM {table}").fetchall(), key=str)
    return found


def run(*words: object, text: str = "") -> Result:
    return CliRunner().invoke(cli, [*map(str, words)], input=text)


def restored(folder: Path, into: Path, *words: object) -> Path:
    """Restore a backup of a folder on a computer that has nothing; return the data folder."""
    into.mkdir()
    config = into / "lineside.toml"
    config.write_text('[server]\ndata = "data"\n[audit]\narchive = "archive"\n')
    (into / "archive").mkdir()
    done = run("restore-store", "--from", folder, *words, "--yes", "--config", config)
    assert done.exit_code == 0, done.output
    assert "left out" not in done.output
    return into / "data"


def test_each_backup_is_the_site_at_its_time_whatever_changed_since(plant: Plant, tmp_path: Path) -> None:
    def drop(connection: StoreConnection) -> None:
        tables.write_raw_from(connection, micros(UnixTime(NOON + HOUR)))
        tables.drop_raw(connection, micros(UnixTime(NOON + HOUR)), 50)

    def several_hours() -> None:
        plant.shelf.keep(polls(NOON - 13 * HOUR, NOON - 13 * HOUR + 90))
        plant.shelf.keep(polls(NOON, NOON + 700))

    steps: list[Callable[[], object]] = [
        several_hours,
        plant.shelf.fold,
        lambda: plant.picture("a" * 64),
        plant.shelf.pack,
        lambda: plant.shelf.keep(polls(NOON + 2 * HOUR, NOON + 2 * HOUR + 65, lambda i: i)),
        plant.shelf.fold,
        lambda: plant.shelf.keep(polls(NOON + 100, NOON + 130, lambda _: 7)),
        plant.shelf.fold,
        lambda: plant.picture("b" * 64),
        lambda: plant.shelf.database.write_now(drop),
        lambda: plant.shelf.database.write_now(
            lambda c: tables.drop_rollups(c, micros(UnixTime(NOON - 24 * HOUR)))
        ),
    ]
    then = []
    for number, step in enumerate(steps):
        step()
        plant.back_up(NOON + number * 600)
        then.append(plant.rows())
    plant.close()
    for number, rows in enumerate(then):
        at = f"2026-11-21T{12 + number // 6}:{number % 6}0:00Z"
        assert rows_of(restored(plant.backups, tmp_path / f"spare {number}", "--at", at)) == rows, number


def test_only_what_is_new_is_written(plant: Plant) -> None:
    plant.shelf.keep(polls(NOON, NOON + 3 * HOUR))
    plant.shelf.fold()
    plant.shelf.pack()
    plant.picture("a" * 64)
    first = plant.back_up(NOON + 3 * HOUR).bytes
    manifest = open_newest(plant.backups)
    main = manifest.size_of("lineside.db")
    again = plant.back_up(NOON + 3 * HOUR + 600).bytes
    assert again < main + 100_000 < first
    before = {path.name for path in (plant.backups / CONTENTS).iterdir()}
    plant.shelf.keep(polls(NOON + 3 * HOUR, NOON + 3 * HOUR + 120))
    plant.shelf.fold()
    plant.back_up(NOON + 3 * HOUR + 1200)
    added = {path.name for path in (plant.backups / CONTENTS).iterdir()} - before
    assert len(added) <= 5, "the main store, the frame, the files, and of history the minutes and the hour"
    plant.close()


def test_two_computers_that_go_on_from_one_backup_keep_their_own(plant: Plant, tmp_path: Path) -> None:
    """The content of a part is told by its version, which no other computer gives to another content."""
    plant.shelf.keep(polls(NOON, NOON + 100))
    plant.shelf.fold()
    plant.back_up(NOON)
    data = restored(plant.backups, tmp_path / "spare")
    spare = load(tmp_path / "spare" / "lineside.toml")
    there = Shelf(data / "history.db")
    for shelf, value in ((plant.shelf, 1), (there, 2)):
        shelf.keep(polls(NOON + 120, NOON + 180, lambda _, value=value: value))  # type: ignore[misc]
        shelf.fold()
    wanted = plant.rows(), rows_of(data)
    for number in range(2):
        plant.back_up(NOON + 600 + number * 1200)
        write_to_folder(spare, plant.backups, UnixTime(NOON + 1200 + number * 1200))
    plant.close()
    there.close()
    for at, rows in (("12:40", wanted[1]), ("12:35", wanted[0]), ("12:20", wanted[1]), ("12:15", wanted[0])):
        back = restored(plant.backups, tmp_path / f"back {at}", "--at", f"2026-11-21T{at}Z")
        assert rows_of(back) == rows, at


def test_the_folder_of_another_site_is_refused_and_stays_as_it_is(plant: Plant, tmp_path: Path) -> None:
    plant.back_up(NOON)
    before = sorted(plant.backups.rglob("*"))
    (tmp_path / "other").mkdir()
    other = Plant(tmp_path / "other")
    # The stores of tests are copies of one.
    other.main.write_now(lambda c: c.execute("UPDATE publisher_identity SET id = 'other'"))
    with pytest.raises(StoreError, match="backups of another site"):
        write_to_folder(other.settings, plant.backups, UnixTime(NOON))
    (plant.backups / SITE).write_text("{")
    with pytest.raises(StoreError, match="is damaged"):
        plant.back_up(NOON)
    assert sorted(plant.backups.rglob("*")) == before
    for each in (plant, other):
        each.close()


def test_a_damaged_content_is_found_in_rotation_and_written_again(plant: Plant, tmp_path: Path) -> None:
    plant.shelf.keep(polls(NOON, NOON + HOUR))
    plant.shelf.fold()
    plant.shelf.pack()
    rows = plant.rows()
    plant.back_up(NOON)
    place = plant.backups / CONTENTS / open_newest(plant.backups).manifest.parts[part_of_noon()][1]
    content = place.read_bytes()
    place.write_bytes(content[:-1] + b"x")
    done = run("restore-store", "--from", plant.backups, "--files-to", tmp_path / "files")
    assert done.exit_code == 0, "what is not damaged comes back"
    for day in range(1, 29):
        assert plant.back_up(NOON + day * 86_400).damaged == []
    assert place.read_bytes() == content
    plant.close()
    assert rows_of(restored(plant.backups, tmp_path / "spare")) == rows


def part_of_noon() -> str:
    start = micros(UnixTime(NOON))
    return f"hour-{start}-{start + 60 * MINUTE}"


def test_the_main_store_is_copied_before_the_pictures_that_its_notes_have(
    plant: Plant, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A picture is stored before its note, so those stored between are more than the notes name."""

    def copy_then_store(store: Path, copy: Path) -> None:
        copy_store(store, copy)
        plant.picture("a" * 64)

    monkeypatch.setattr("app.system.backup.folder.copy_store", copy_then_store)
    plant.back_up(NOON)
    plant.close()
    assert len(rows_of(restored(plant.backups, tmp_path / "spare"))["pictures.db picture"]) == 1


@pytest.mark.parametrize("damage", ["absent", "other bytes", "fifo"])
def test_a_restore_leaves_out_what_is_damaged_and_says_so(plant: Plant, damage: str) -> None:
    plant.shelf.keep(polls(NOON, NOON + HOUR))
    plant.shelf.fold()
    plant.shelf.pack()
    plant.back_up(NOON)
    plant.close()
    place = plant.backups / CONTENTS / open_newest(plant.backups).manifest.parts[part_of_noon()][1]
    place.unlink()
    if damage == "other bytes":
        place.write_bytes(b"other")
    elif damage == "fifo":
        subprocess.run(["mkfifo", place], check=True)
    done = run("restore-store", "--from", plant.backups, "--yes", "--config", plant.config)
    assert (done.exit_code, "1 part of the history" in done.stdout) == (0, True), done.output
    assert plant.rows()["history.db minutes"] != []
    main = open_newest(plant.backups).manifest.stores["lineside.db"]
    (plant.backups / CONTENTS / main).write_bytes(b"other")
    before = plant.settings.server.store.read_bytes()
    done = run("restore-store", "--from", plant.backups, "--yes", "--config", plant.config)
    assert (done.exit_code, "is damaged: lineside.db" in done.stderr) == (1, True), done.output
    assert plant.settings.server.store.read_bytes() == before


def test_a_manifest_that_cannot_be_read_is_no_backup_and_keeps_all_contents(
    plant: Plant, tmp_path: Path
) -> None:
    plant.back_up(NOON)
    whole = (plant.backups / name_of(UnixTime(NOON))).read_text()
    half = plant.backups / name_of(UnixTime(NOON + 600))
    stray = plant.backups / CONTENTS / ("0" * 64)
    for content in ("", whole[: len(whole) // 2], whole.replace("lineside.db", "../foreign"), "[]"):
        half.write_text(content)
        assert open_newest(plant.backups).path.name == name_of(UnixTime(NOON))
    stray.write_text("x")
    for number in range(2, 3 + REMOVE_EVERY):
        plant.back_up(NOON + number * 600)
    assert stray.exists()
    half.unlink()
    for number in range(3 + REMOVE_EVERY, 4 + 2 * REMOVE_EVERY):
        plant.back_up(NOON + number * 600)
    assert not stray.exists()
    plant.close()
    (tmp_path / "empty").mkdir()
    for words in (("--from", tmp_path / "empty"), ("--from", plant.backups, "--at", "2026-01-01T00:00")):
        done = run("restore-store", *words, "--config", plant.config)
        assert (done.exit_code, "there is no backup" in done.stderr) == (1, True), done.output
    done = run("restore-store", "--from", plant.backups, "--at", "monday", "--config", plant.config)
    assert (done.exit_code, "'monday' is no time" in done.stderr) == (2, True)
    for both in ((), (half, "--from", plant.backups)):
        assert run("restore-store", *both, "--config", plant.config).exit_code == 2


def test_backups_that_are_too_many_go_with_what_only_they_name(plant: Plant, tmp_path: Path) -> None:
    rows = []
    for day in range(20):
        query = f"INSERT INTO read_only VALUES ('bus {day}', 'x', 'anna', 1, NULL)"
        plant.main.write_now(lambda c, query=query: c.execute(query))  # type: ignore[misc]
        plant.shelf.keep(polls(NOON + day * 86_400, NOON + day * 86_400 + 60))
        plant.shelf.fold()
        plant.back_up(NOON + day * 86_400 + 600)
        rows.append(plant.rows())
    manifests = sorted(plant.backups.glob("lineside-2*.json"))
    assert len(manifests) == 14
    named = set()
    for path in manifests:
        manifest = json.loads(path.read_text())
        named |= {*manifest["stores"].values(), *(digest for _, digest in manifest["parts"].values())}
    left = {path.name for path in (plant.backups / CONTENTS).iterdir()}
    assert len(left - named) < 4 * REMOVE_EVERY
    plant.close()
    assert rows_of(restored(plant.backups, tmp_path / "spare")) == rows[-1]


@pytest.mark.parametrize(
    ("options", "reason"), [("size=300k", "bytes while it is made"), ("size=64k,ro", "Read-only")]
)
def test_a_disk_that_cannot_take_it_is_named_and_keeps_what_it_has(
    plant: Plant, options: str, reason: str
) -> None:
    with mounted("-t", "tmpfs", "-o", options, "tmpfs", at=plant.backups):
        with pytest.raises(StoreError, match=reason):
            plant.back_up(NOON)
        assert [*plant.backups.glob("lineside-2*")] == []
    shutil.rmtree(plant.backups)
    with pytest.raises(StoreError, match="mount its disk"):
        plant.back_up(NOON)
    plant.close()


def test_a_disk_that_fills_up_meanwhile_leaves_the_former_backup(
    plant: Plant, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant.shelf.keep(polls(NOON, NOON + 60))
    plant.shelf.fold()
    rows = plant.rows()
    monkeypatch.setattr("app.system.backup.folder.MARGIN", 0)
    with mounted("-t", "tmpfs", "-o", "size=2m", "tmpfs", at=plant.backups):
        plant.back_up(NOON)
        (plant.backups / "other").write_bytes(bytes(plant.settings.server.store.stat().st_size // 2))
        for number in range(20):
            plant.picture(f"{number:064}")
        with pytest.raises(StoreError, match=r"No space left|bytes while it is made|disk is full") as raised:
            until_it_is_full(plant)
        assert str(plant.backups) in str(raised.value)
        kept = tmp_path / "kept"
        shutil.copytree(plant.backups, kept)
    plant.close()
    back = rows_of(restored(kept, tmp_path / "spare", "--at", "2026-11-21T12:00Z"))
    assert back["history.db raw"] == rows["history.db raw"]


def until_it_is_full(plant: Plant) -> None:
    for number in range(20, 200):
        plant.picture(f"{number:064}")
        plant.back_up(NOON + number * 600)


@pytest.fixture
async def archived(tmp_path: Path) -> Settings:
    return await archived_site(tmp_path)


def test_archived_events_come_back_from_a_folder_and_from_beside_an_archive_of_version_02(
    archived: Settings, tmp_path: Path
) -> None:
    settings = archived
    backups, old = tmp_path / "backups", tmp_path / "02"
    for folder in (backups, old, old / KEPT_EVENTS):
        folder.mkdir()
    assert len(write_to_folder(settings, backups, UnixTime(NOON)).events) == 3
    archive = tmp_path / "archive"
    assert run("backup-store", tmp_path / "one.tar", "--config", tmp_path / "lineside.toml").exit_code == 0
    as_version_02(tmp_path / "one.tar", old)
    for backup in (("--from", backups), (old / "one.tar",)):
        shutil.rmtree(archive)
        archive.mkdir()
        done = run("restore-store", *backup, "--yes", "--config", tmp_path / "lineside.toml")
        assert (done.exit_code, "not restored" in done.stdout) == (0, False), done.output
        assert "the archive is intact: 6 of these entries" in verified(settings)
    [kept, *_] = (old / KEPT_EVENTS).iterdir()
    kept.write_bytes(b"damaged")
    shutil.rmtree(archive)
    archive.mkdir()
    done = run("restore-store", old / "one.tar", "--yes", "--config", tmp_path / "lineside.toml")
    assert (done.exit_code, "missing or damaged" in done.stdout) == (0, True), done.output
    assert len([*archive.iterdir()]) == 2


def as_version_02(archive: Path, folder: Path) -> None:
    """Write an archive as ``backup-store --share-events`` of version 0.2 did."""
    unpacked = archive.with_name("unpacked")
    with tarfile.open(archive) as packed:
        packed.extractall(unpacked, filter="data")
    manifest = json.loads((unpacked / "manifest.json").read_text())
    manifest["kept_events"] = manifest.pop("events")
    (unpacked / "manifest.json").write_text(json.dumps(manifest))
    with tarfile.open(folder / archive.name, "w") as packed:
        for path in sorted(unpacked.iterdir()):
            if (digest := manifest["kept_events"].get(path.name)) is None:
                packed.add(path, path.name)
            else:
                path.rename(folder / KEPT_EVENTS / f"{digest}.jsonl.gz")


def test_the_log_after_a_restore_begins_with_the_backup_and_is_proven(plant: Plant, tmp_path: Path) -> None:
    plant.back_up(NOON)
    plant.close()
    data = restored(plant.backups, tmp_path / "spare")
    with closing(sqlite3.connect(data / "lineside.db")) as store:
        [(what, message)] = store.execute("SELECT messages, message FROM events ORDER BY id DESC LIMIT 1")
    assert "event_stores_restored" in what
    assert name_of(UnixTime(NOON)) in message
    assert "the audit log is intact" in verified(load(tmp_path / "spare" / "lineside.toml"))[0]


@needs_postgresql
async def test_a_restore_says_what_the_plants_database_has_of_after_the_backup(tmp_path: Path) -> None:
    backups, config = tmp_path / "backups", tmp_path / "lineside.toml"
    backups.mkdir()
    with fresh_database() as url:
        async with publishing(tmp_path, url, "all") as house:
            await asyncio.to_thread(write_to_folder, load(config), backups, UnixTime(time.time() - 120))
            await house.services[EventLog].record(kind="unit", what="offline", bus="dry-end", unit=1)
            keep(house, [reading(1, time.time() - number, 500) for number in (60, 50, 40)])
            await published(house)
            # Readings of before this run go with the next look at the history.
            await until(
                lambda: published_rows(url, "SELECT 1 FROM lineside.reading LIMIT 1"), "readings published"
            )
        restore = ("restore-store", "--from", backups, "--yes", "--config", config)
        done = await asyncio.to_thread(run, *restore)
        assert done.exit_code == 0, done.output
        assert "has 1 event of after the backup, of " in done.stdout
        assert re.search(r"has \d readings? of after the backup, ", done.stdout)
    config.write_text(config.read_text().replace(url, "postgresql://nobody@127.0.0.1:1/none"))
    done = await asyncio.to_thread(run, *restore)
    assert (done.exit_code, "may be in " in done.stdout) == (0, True), done.output


@pytest.mark.parametrize("kills", sizes(1, 50))
def test_whatever_is_killed_every_finished_backup_restores(tmp_path: Path, kills: int) -> None:
    config, chance = make_site(tmp_path), random.Random(38)
    backups, finished = tmp_path / "backups", 0
    backups.mkdir()
    backup = ("backup-store", backups, "--config", config)
    site: tuple[str | Path, ...] = (sys.executable, "-m", "tests.app.busy_site", config)
    writing, nowhere = subprocess.Popen(site), os.open(os.devnull, os.O_WRONLY)
    try:
        for _ in range(kills):
            begun = time.monotonic()
            if fork_server.run(*backup).returncode == 0:
                finished += 1
            took = time.monotonic() - begun
            backing_up = fork_server.start(*backup, stdout=nowhere, stderr=nowhere)
            time.sleep(chance.uniform(0, took))
            backing_up.kill()
            backing_up.wait()
            if chance.random() < 0.5:
                writing.kill()
                writing.wait()
                writing = subprocess.Popen(site)
            number = len([*backups.glob("lineside-2*.json")])
            assert number >= min(finished, 1)
    finally:
        os.close(nowhere)
        writing.kill()
        writing.wait()
    assert finished >= max(kills - 1, 1)
    for number, path in enumerate(sorted(backups.glob("lineside-2*.json"))):
        spare = tmp_path / f"spare {number}"
        spare.mkdir()
        for name in ("lineside.toml", "lineside.audit.key"):
            shutil.copy(tmp_path / name, spare)
        at = path.name.removeprefix("lineside-").removesuffix(".json")
        words = ("--from", backups, "--at", at, "--yes", "--config", spare / "lineside.toml")
        done = run("restore-store", *words)
        assert (done.exit_code, "left out" in done.output) == (0, False), done.output
        rows_of(spare / "data")
        with closing(sqlite3.connect(spare / "data" / "lineside.db")) as store:
            assert store.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        done = run("audit", "verify", "--config", spare / "lineside.toml")
        assert done.exit_code == 0, done.output
        shutil.rmtree(spare)
