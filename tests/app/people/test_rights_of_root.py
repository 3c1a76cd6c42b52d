"""What root starts leaves no file of root in the folders of the service."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from app.cli.command import become_owner_of
from tests import fork_server

pytestmark = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder away")
SERVICE = 4321
"""A user without a name."""


@pytest.fixture
def tmp_path() -> Iterator[Path]:
    """A folder that the service can enter: those of pytest are root's alone, and closed again by each run."""
    with tempfile.TemporaryDirectory(prefix="lineside-rights-") as folder:
        Path(folder).chmod(0o755)
        yield Path(folder)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """A configuration and a data folder of the service."""
    made = tmp_path / "etc" / "lineside.toml"
    for folder in (made.parent, tmp_path / "data"):
        folder.mkdir(mode=0o700)
        os.chown(folder, SERVICE, SERVICE)
    made.write_text('[server]\ndata = "../data"\n')
    os.chown(made, SERVICE, SERVICE)
    return made


def owners(folder: Path) -> set[int]:
    return {path.lstat().st_uid for path in folder.rglob("*")}


def done(*arguments: str | Path, text: str = "") -> None:
    result = fork_server.run(*arguments, text=text)
    assert result.returncode == 0, result.stderr


def test_commands_that_write_act_as_the_owner_of_the_data(config: Path, tmp_path: Path) -> None:
    password = "collect house bakery stable\n"
    done("user", "add", "anna", "--role", "admin", "--password-stdin", "--config", config, text=password)
    done("audit", "rotate-key", "--config", config)
    done("certificate", "create", "--config", config)
    assert (tmp_path / "data" / "lineside.db").is_file()
    assert owners(tmp_path / "data") | owners(config.parent) == {SERVICE}


def test_a_backup_of_root_is_restored_for_the_service(config: Path, tmp_path: Path) -> None:
    done("token", "create", "plc", "--role", "viewer", "--config", config)
    backup = tmp_path / "backup.tar"
    done("backup-store", backup, "--config", config)
    assert (backup.stat().st_uid, backup.stat().st_mode & 0o777) == (0, 0o600)
    assert owners(tmp_path / "data") == {SERVICE}, "to read leaves nothing"
    done("restore-store", backup, "--yes", "--config", config)
    assert owners(tmp_path / "data") == {SERVICE}
    done("token", "list", "--config", config)


def test_a_first_configuration_is_of_who_has_the_folder(config: Path) -> None:
    config.unlink()
    done("init", "--config", config)
    assert owners(config.parent) == {SERVICE}


def test_a_data_folder_that_is_not_there_yet_becomes_the_service_s(config: Path, tmp_path: Path) -> None:
    state = tmp_path / "state"
    state.mkdir(mode=0o700)
    os.chown(state, SERVICE, SERVICE)
    config.write_text('[server]\ndata = "../state/data"\n')
    done("token", "create", "plc", "--role", "viewer", "--config", config)
    assert (state / "data" / "lineside.db").is_file()
    assert owners(state) | owners(config.parent) == {SERVICE}


def test_a_folder_of_root_or_none_changes_nothing(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "absent"):
        become_owner_of(folder)
        assert os.geteuid() == 0
