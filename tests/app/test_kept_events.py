"""Archived events that are kept once for many backups: each backup is complete with the folder beside it, on
its own, and a damaged file is found and copied again."""

from __future__ import annotations

import json
import os
import shutil
import tarfile
from pathlib import Path

import pytest

from app.cli.stores.backup_store import space_needed
from app.cli.stores.kept_events import FOLDER, is_kept
from app.settings import Settings
from tests.app.archived_site import archived_site
from tests.app.test_backup_archived_events import MONTHS, restored, run
from tests.app.test_cli_archive import verified


@pytest.fixture
async def site(tmp_path: Path) -> Settings:
    (tmp_path / "backups").mkdir()
    return await archived_site(tmp_path)


def written(folder: Path, name: str) -> Path:
    backup = folder / "backups" / name
    done = run("backup-store", backup, "--share-events", "--config", folder / "lineside.toml", "--json")
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert (document["events"], document["events_absent"]) == (MONTHS, [])
    return backup


def kept(folder: Path) -> dict[Path, os.stat_result]:
    return {path: path.stat() for path in (folder / "backups" / FOLDER).iterdir()}


def lose_archive(folder: Path) -> None:
    for path in (folder / "archive").iterdir():
        path.unlink()


def test_two_backups_have_one_archive_and_each_is_restored_without_the_other(
    site: Settings, tmp_path: Path
) -> None:
    first, before = written(tmp_path, "1.tar"), kept(tmp_path)
    second = written(tmp_path, "2.tar")
    assert (len(before), kept(tmp_path)) == (len(MONTHS), before), "a file that is there is not written again"
    assert all(found.st_mode & 0o077 == 0 for found in before.values())
    with tarfile.open(second) as packed:
        assert not {*packed.getnames()} & {*MONTHS}
    first.unlink()
    third = written(tmp_path, "3.tar")
    assert kept(tmp_path) == before
    third.unlink()
    lose_archive(tmp_path)
    done = restored(tmp_path, second)
    assert done.exit_code == 0, done.stderr
    assert sorted(path.name for path in (tmp_path / "archive").iterdir()) == MONTHS
    assert "the archive is intact: 6 of these entries" in verified(site)


@pytest.mark.usefixtures("site")
@pytest.mark.parametrize("damage", ["other bytes", "absent", "link", "fifo"])
def test_a_damaged_file_is_found_by_a_restore_and_copied_again_by_the_next_backup(
    tmp_path: Path, damage: str
) -> None:
    first = written(tmp_path, "1.tar")
    place = min(kept(tmp_path))
    digest = place.name.partition(".")[0]
    content = place.read_bytes()
    place.unlink()
    if damage == "other bytes":
        place.write_bytes(content[:-1])
    elif damage == "link":
        place.symlink_to(tmp_path / "archive" / MONTHS[0])
    elif damage == "fifo":
        os.mkfifo(place)
    archive = tmp_path / "archive"
    shutil.copytree(archive, tmp_path / "safe")
    lose_archive(tmp_path)
    done = restored(tmp_path, first)
    assert (done.exit_code, "missing or damaged in" in done.stdout) == (0, True), done.output
    assert len([*archive.iterdir()]) == len(MONTHS) - 1, "the others come back, and all stores"
    shutil.copytree(tmp_path / "safe", archive, dirs_exist_ok=True)
    written(tmp_path, "2.tar")
    assert is_kept(place.parent, digest)
    lose_archive(tmp_path)
    done = restored(tmp_path, first)
    assert (done.exit_code, "missing or damaged" in done.stdout) == (0, False), done.output
    assert len([*archive.iterdir()]) == len(MONTHS)


@pytest.mark.usefixtures("site")
def test_the_archive_may_be_on_another_file_system(tmp_path: Path) -> None:
    """/dev/shm is another one, across which no hard link leads."""
    away = Path("/dev/shm") / f"lineside-test-{os.getpid()}"
    away.mkdir()
    try:
        if away.stat().st_dev == tmp_path.stat().st_dev:
            pytest.skip("there is one file system only")
        (tmp_path / "backups").rmdir()
        (tmp_path / "backups").symlink_to(away)
        backup = written(tmp_path, "1.tar")
        lose_archive(tmp_path)
        assert restored(tmp_path, backup).exit_code == 0
        assert sorted(path.name for path in (tmp_path / "archive").iterdir()) == MONTHS
    finally:
        shutil.rmtree(away)


@pytest.mark.usefixtures("site")
def test_what_no_backup_refers_to_goes_unless_one_cannot_be_read(tmp_path: Path) -> None:
    written(tmp_path, "1.tar")
    stray, other = (tmp_path / "backups" / FOLDER / name for name in (f"{'0' * 64}.jsonl.gz", "a note.txt"))
    unread = tmp_path / "backups" / "unread.tar"
    for path in (stray, other, unread):
        path.write_text("x")
    written(tmp_path, "2.tar")
    assert stray.exists()
    unread.unlink()
    written(tmp_path, "3.tar")
    assert (stray.exists(), other.exists(), len(kept(tmp_path))) == (False, True, len(MONTHS) + 1)


@pytest.mark.usefixtures("site")
def test_a_folder_that_is_a_link_is_refused(tmp_path: Path) -> None:
    (tmp_path / "backups" / FOLDER).symlink_to(tmp_path / "archive")
    words = ("--share-events", "--config", tmp_path / "lineside.toml")
    done = run("backup-store", tmp_path / "backups" / "1.tar", *words)
    assert (done.exit_code, "is a link" in done.stderr) == (1, True), done.output
    assert sorted(path.name for path in (tmp_path / "archive").iterdir()) == MONTHS
    assert [path.name for path in (tmp_path / "backups").iterdir()] == [FOLDER]


def test_the_next_backup_needs_no_room_for_kept_events(site: Settings, tmp_path: Path) -> None:
    data, archive = site.server.data, site.audit.archive
    beside = tmp_path / "backups" / FOLDER
    assert space_needed(data, archive, beside) > space_needed(data, None)
    written(tmp_path, "1.tar")
    assert space_needed(data, archive, beside) == space_needed(data, None)
