"""Archived events and versions of the configuration in a backup: rehearsed until the log is proven again."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from app.cli import cli
from app.settings import Settings
from app.system.configuration.document import ConfigurationVersion, StoredVersion, VersionStore
from bus.instants import UnixTime
from tests.app.archived_site import archived_site
from tests.app.cli.test_backup_store import verified

MONTHS = [f"events-2026-0{month}.jsonl.gz" for month in (1, 2, 3)]


@pytest.fixture
async def site(tmp_path: Path) -> Settings:
    return await archived_site(tmp_path)


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(cli, [str(word) for word in words])


def written(folder: Path) -> Path:
    """A backup of the site, which has all three months."""
    config, backup = folder / "lineside.toml", folder / "one.tar"
    done = run("backup-store", backup, "--config", config, "--json")
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert (document["events"], document["events_absent"]) == (MONTHS, [])
    return backup


def restored(folder: Path, backup: Path) -> Result:
    return run("restore-store", backup, "--config", folder / "lineside.toml", "--yes")


def test_a_lost_archive_comes_back_and_is_proven(site: Settings, tmp_path: Path) -> None:
    backup, archive = written(tmp_path), tmp_path / "archive"
    shutil.rmtree(tmp_path / "data")
    (archive / MONTHS[0]).unlink()
    kept = (archive / MONTHS[1]).stat()
    done = restored(tmp_path, backup)
    assert done.exit_code == 0, done.stderr
    assert str(archive / MONTHS[0]) in done.stdout
    assert (archive / MONTHS[1]).stat() == kept, "a file that is there is not written again"
    assert sorted(path.name for path in archive.iterdir()) == MONTHS
    assert "the archive is intact: 6 of these entries" in verified(site)


@pytest.mark.usefixtures("site")
@pytest.mark.parametrize(
    ("problem", "text"),
    [
        ("other", "events-2026-02.jsonl.gz is not the file that the backup has"),
        ("no folder", "archive in [audit] is not there"),
        ("not named", "name a folder for them as archive in [audit]"),
    ],
)
def test_an_archive_that_cannot_take_them_leaves_all_as_it_is(
    tmp_path: Path, problem: str, text: str
) -> None:
    backup, archive, config = written(tmp_path), tmp_path / "archive", tmp_path / "lineside.toml"
    if problem == "other":
        (archive / MONTHS[1]).write_bytes(b"of another log")
    elif problem == "no folder":
        archive.rename(tmp_path / "elsewhere")
    else:
        config.write_text(config.read_text().replace("archive", "#archive"))
    before = (tmp_path / "data" / "lineside.db").read_bytes()
    done = restored(tmp_path, backup)
    assert (done.exit_code, text in done.stderr) == (1, True), done.stderr
    assert (tmp_path / "data" / "lineside.db").read_bytes() == before
    if problem == "other":
        assert (archive / MONTHS[1]).read_bytes() == b"of another log"


@pytest.mark.usefixtures("site")
def test_a_damaged_month_is_refused_and_one_in_a_safe_is_named(tmp_path: Path) -> None:
    month, words = tmp_path / "archive" / MONTHS[0], ("--config", tmp_path / "lineside.toml")
    month.rename(tmp_path / MONTHS[0])
    done = run("backup-store", tmp_path / "one.tar", *words)
    assert (done.exit_code, MONTHS[0] in done.stdout.splitlines()[1]) == (0, True), done.output
    month.write_bytes(b"damaged")
    done = run("backup-store", tmp_path / "two.tar", *words)
    assert (done.exit_code, "not as it was written" in done.stderr) == (1, True)
    assert not (tmp_path / "two.tar").exists()
    month.unlink()
    month.symlink_to(tmp_path / MONTHS[0])
    done = run("backup-store", tmp_path / "two.tar", *words)
    assert (done.exit_code, MONTHS[0] in done.stdout.splitlines()[0]) == (0, True), done.output
    assert restored(tmp_path, tmp_path / "two.tar").exit_code == 0


def test_the_versions_of_the_configuration_come_back(site: Settings, tmp_path: Path) -> None:
    versions = VersionStore(site.server.data)
    for number in (1, 2):
        version = ConfigurationVersion(number, UnixTime(1.0), "changed", f"{number}", "anna", "why")
        versions.add(StoredVersion(version, f"# {number}"))
    backup, kept = written(tmp_path), versions.every()
    assert [stored.version.number for stored in kept] == [2, 1]
    assert run("restore-store", backup, "--files-to", tmp_path / "back").exit_code == 0
    back = VersionStore(tmp_path / "back" / site.server.data.relative_to("/"))
    assert back.every() == kept
