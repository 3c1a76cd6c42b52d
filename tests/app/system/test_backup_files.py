"""What a backup has of a site beside its stores: everything that a restore needs, and no secret in clear."""

from __future__ import annotations

import base64
import fcntl
import os
import stat
import tarfile
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner, Result

from app.cli import cli
from app.cli.findings import backup as backup_findings
from app.errors import StoreError
from app.settings import load
from app.system.backup.archive import WORKING
from app.system.backup.folder import SITE
from app.system.backup.stores import ENCRYPTED, IN_CLEAR, SiteFile, decrypt, encrypt, files_of, place_files
from tests.app.backups import write_backup
from tests.e2e.site import add_people
from tests.mounted import mounted

KEY = "0123456789abcdef" * 4
SECRETS = ("mail-secret-1", "hook-secret-2")
CONFIGURATION = """\
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
secret_file = "keys/hook.key"
"""
OF_VERSION_02 = "lPYS6d5yHPHv/1sqEYbBEBLBsfxF/3/gFQ4vJV+A0to6iHhxRV4cVsRrimAHbL9VXfMbEAl7xpk="
"""``[secret]`` under `KEY`, as version 0.2 wrote it with the program openssl."""
WITH_KEY = '[backup]\nkey_file = "backup.key"\n'


@pytest.fixture
def site(tmp_path: Path) -> Path:
    (tmp_path / "keys").mkdir()
    (tmp_path / "mail.password").write_text("mail-secret-1\n")
    (tmp_path / "keys" / "hook.key").write_text("hook-secret-2\n")
    (tmp_path / "backup.key").write_text(f"{KEY}\n")
    (tmp_path / "lineside.toml").write_text(CONFIGURATION)
    add_people(tmp_path / "lineside.toml")
    return tmp_path


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(cli, [str(word) for word in words])


def test_with_a_key_everything_comes_back_and_no_secret_is_in_clear(site: Path) -> None:
    config, archive, folder = site / "lineside.toml", site / "one.tar", site / "back"
    config.write_text(CONFIGURATION + WITH_KEY)
    audit_key = (site / "lineside.audit.key").read_bytes()
    done = run("backup-store", archive, "--config", config)
    assert (done.exit_code, len(done.stdout.splitlines())) == (0, 1), done.output
    packed = archive.read_bytes()
    assert [word for word in (*SECRETS, "hooks.example") if word.encode() in packed] == []
    assert audit_key.strip() not in packed
    restored = run("restore-store", archive, "--files-to", folder, "--key-file", site / "backup.key")
    assert restored.exit_code == 0, restored.output
    names = ("lineside.toml", "lineside.audit.key", "mail.password", "keys/hook.key")
    for name in names:
        back = folder / (site / name).relative_to("/")
        assert back.read_bytes() == (site / name).read_bytes()
        assert stat.S_IMODE(back.stat().st_mode) == 0o600
    found = [path for path in folder.rglob("*") if path.is_file()]
    assert len(found) == len(names), "the key itself is not in it"
    again = run("restore-store", archive, "--files-to", folder, "--key-file", site / "backup.key")
    assert (again.exit_code, "exists already" in again.stderr) == (1, True)
    without = run("restore-store", archive, "--files-to", site / "other")
    assert (without.exit_code, "--key-file" in without.stderr) == (1, True)


def test_without_a_key_it_has_the_configuration_and_names_the_files_left_out(site: Path) -> None:
    config, archive, folder = site / "lineside.toml", site / "one.tar", site / "back"
    done = run("backup-store", archive, "--config", config)
    left_out = done.stdout.splitlines()[1]
    for name in ("lineside.audit.key", "mail.password", "hook.key"):
        assert name in left_out
    assert [word for word in SECRETS if word.encode() in archive.read_bytes()] == []
    assert run("restore-store", archive, "--files-to", folder).exit_code == 0
    assert (folder / config.relative_to("/")).read_text() == CONFIGURATION
    restored = run("restore-store", archive, "--config", config, "--yes")
    assert restored.exit_code == 0, restored.stderr


def test_another_key_and_altered_files_are_refused() -> None:
    packed = encrypt(b"secret", KEY.encode())
    assert packed != encrypt(b"secret", KEY.encode())
    assert decrypt(packed, KEY.encode()) == b"secret"
    altered = bytes([*packed[:-1], packed[-1] ^ 1])
    for wrong, key in ((packed, KEY[:-1]), (altered, KEY), (packed[:40], KEY), (b"", KEY)):
        with pytest.raises(StoreError, match="another key, or altered"):
            decrypt(wrong, key.encode())


@pytest.mark.parametrize(
    ("written", "reason"), [(None, "cannot be read"), ("too short", "fewer than"), (KEY, "in their folder")]
)
def test_a_key_that_protects_nothing_is_refused(site: Path, written: str | None, reason: str) -> None:
    config = site / "lineside.toml"
    folder = "." if written == KEY else "copies"
    config.write_text(f'{CONFIGURATION}[backup]\nfolder = "{folder}"\nkey_file = "backup.key"\n')
    (site / "backup.key").unlink()
    if written is not None:
        (site / "backup.key").write_text(written)
    with pytest.raises(StoreError, match=reason):
        files_of(load(config))


def test_files_that_version_02_encrypted_by_openssl_are_read() -> None:
    assert decrypt(base64.b64decode(OF_VERSION_02), KEY.encode()) == b"[secret]"


def test_forged_paths_and_damaged_files_are_refused(tmp_path: Path) -> None:
    for path in ("etc/lineside.toml", "/etc/../../lineside.toml", "", "/etc/\0"):
        content = msgspec.json.encode([SiteFile(path, b"forged")])
        with pytest.raises(StoreError, match="damaged"):
            place_files(IN_CLEAR, content, None, tmp_path / "back")
        assert not (tmp_path / "back").exists()
    with pytest.raises(StoreError, match="damaged"):
        place_files(IN_CLEAR, b"[{}]", None, tmp_path / "back")
    with pytest.raises(StoreError, match="--key-file"):
        place_files(ENCRYPTED, b"", None, tmp_path / "back")


def test_a_backup_of_an_earlier_version_has_no_files(site: Path) -> None:
    write_backup(site / "data", site / "one.tar")
    done = run("restore-store", site / "one.tar", "--files-to", site / "back")
    assert (done.exit_code, "earlier version" in done.stderr) == (1, True)


def test_what_a_killed_backup_left_is_removed_and_what_one_at_work_has_is_not(site: Path) -> None:
    left, used = site / f"{WORKING}left", site / f"{WORKING}used"
    for folder in (left, used):
        folder.mkdir()
        (folder / "history.db").write_text("half")
    descriptor = os.open(used, os.O_RDONLY)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    write_backup(site / "data", site / "one.tar")
    os.close(descriptor)
    assert not left.exists()
    assert [path.name for path in used.iterdir()] == ["history.db"]
    assert sorted(path.name for path in site.glob(f"{WORKING}*")) == [used.name]


def test_no_file_is_written_over_that_came_meanwhile(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    archive, opened = site / "one.tar", tarfile.open

    def come(*words: object, **named: object) -> object:
        archive.write_text("mine")
        return opened(*words, **named)  # type: ignore[call-overload]

    monkeypatch.setattr("app.system.backup.archive.tarfile.open", come)
    with pytest.raises(StoreError, match="exists"):
        write_backup(site / "data", archive)
    assert archive.read_text() == "mine"


@pytest.mark.parametrize(
    ("written", "text", "is_fault"),
    [
        ('folder = "copies"', "backups: each night at 02:30 in ", False),
        ('folder = "none"', "none is not there; mount its disk", True),
        ('folder = "lineside.toml"', "is not there", True),
        ('folder = "copies"\nkey_file = "mail.password"', "has fewer than 32 characters", True),
        ('folder = "copies"\nevery = "10 min"', "backups: every 10 min in ", False),
        ('folder = "foreign"', "foreign has the backups of another site (Plant 2)", True),
        ('folder = "half"', "lineside-site.json is damaged", True),
    ],
)
def test_the_check_names_what_keeps_a_backup_from_being_written(
    site: Path, written: str, text: str, is_fault: bool
) -> None:
    for name, content in (("copies", None), ("foreign", '{"site": "1", "name": "Plant 2"}'), ("half", "{")):
        (site / name).mkdir()
        if content is not None:
            (site / name / SITE).write_text(content)
    (site / "lineside.toml").write_text(f"{CONFIGURATION}[backup]\n{written}\n")
    found = [*backup_findings(load(site / "lineside.toml"))]
    assert [finding.is_fault for finding in found if text in str(finding.message)] == [is_fault]


def test_the_check_names_a_disk_that_is_too_small(site: Path) -> None:
    disk = site / "disk"
    disk.mkdir()
    (site / "lineside.toml").write_text(f'{CONFIGURATION}[backup]\nfolder = "disk"\n')
    with mounted("-t", "tmpfs", "-o", "size=64k", "tmpfs", at=disk):
        [found] = backup_findings(load(site / "lineside.toml"))
    assert found.is_fault
    assert "disk has 0 MB free" in str(found.message)


def test_a_disk_that_is_too_small_is_named_before_anything_is_written(site: Path) -> None:
    disk = site / "disk"
    disk.mkdir()
    with mounted("-t", "tmpfs", "-o", "size=300k", "tmpfs", at=disk):
        with pytest.raises(StoreError, match=r"two\.tar needs \d+ bytes while it is made"):
            write_backup(site / "data", disk / "two.tar")
        assert [*disk.iterdir()] == []
