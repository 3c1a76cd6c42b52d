"""Another user of the machine, or of its backups, reads or plants no file of ours."""

from __future__ import annotations

import os
import re
import signal
import subprocess
from pathlib import Path

import pytest

from app import cli
from app.core.database import Database
from app.core.database.files import make_private, write_file
from app.errors import StoreError
from bus import __main__ as worker
from bus.worker import process as parent
from tests import fork_server

CONFIG = """\
[server]
port = 0
data = "data"
[audit]
anchor = "anchor"
[[bus]]
name = "dry-end"
port = "/dev/nowhere"
[[bus.unit]]
id = 1
name = "Unwind"
"""
as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file away")


def loose(folder: Path) -> list[str]:
    """What others could use."""
    return sorted(
        f"{path.relative_to(folder)} {path.lstat().st_mode & 0o777:o}"
        for path in folder.rglob("*")
        if path.lstat().st_mode & 0o077 and not path.is_symlink()
    )


def lineside(folder: Path, *words: str, text: str = "") -> str:
    """Run the command with a umask that removes no permission."""
    done = fork_server.run(*words, "--config", folder / "lineside.toml", text=text, umask=0)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_file_of_every_process_is_private_and_what_was_not_is_repaired(tmp_path: Path) -> None:
    (tmp_path / "lineside.toml").write_text(CONFIG)
    lineside(
        tmp_path, "user", "add", "ann", "--role", "admin", "--password-stdin", text="correct horse battery\n"
    )
    assert loose(tmp_path) == ["lineside.toml 644"]
    data = tmp_path / "data"
    for path in (data, *data.rglob("*")):
        path.chmod(0o777 if path.is_dir() else 0o666)
    (tmp_path / "anchor").touch(0o644)
    serving = fork_server.start(
        "serve", "--config", tmp_path / "lineside.toml", stdout=subprocess.PIPE, umask=0
    )
    try:
        assert serving.stdout is not None
        assert re.search("http://", serving.stdout.readline())
        lineside(tmp_path, "backup-store", str(tmp_path / "copy"))
        assert loose(tmp_path) == ["lineside.toml 644"]
    finally:
        serving.send_signal(signal.SIGTERM)
        serving.wait()
        serving.stdout.close()
    assert loose(tmp_path) == ["lineside.toml 644"]
    lineside(tmp_path, "restore-store", str(tmp_path / "copy"), "--yes")
    lineside(tmp_path, "audit", "rotate-key")
    assert loose(tmp_path) == ["lineside.toml 644"]
    assert {path.name for path in data.iterdir()} >= {"lineside.db", "history.db", "lock", "compiled"}


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Return a data folder that every user can write to."""
    folder = tmp_path / "data"
    (folder / "compiled").mkdir(parents=True)
    (folder / "history.db-wal").touch()
    (folder / "compiled" / "__jinja2_x.cache").write_bytes(b"code")
    for path in (folder, *folder.rglob("*")):
        path.chmod(0o777)
    return folder


def test_what_others_could_have_planted_as_code_is_thrown_away(data: Path) -> None:
    make_private(data)
    assert loose(data.parent) == []
    assert not (data / "compiled").exists()


def test_links_lead_to_nothing_of_others(data: Path, tmp_path: Path) -> None:
    elsewhere, folder = tmp_path / "elsewhere", tmp_path / "folder"
    elsewhere.write_text("keep")
    folder.mkdir()
    for path, mode in ((elsewhere, 0o644), (folder, 0o755)):
        path.chmod(mode)
    (data / "link").symlink_to(elsewhere)
    (data / "folder").symlink_to(folder)
    (data / "hard").hardlink_to(elsewhere)
    make_private(data)
    write_file(data / "link", b"new")
    assert elsewhere.read_text() == "keep"
    assert (elsewhere.stat().st_mode & 0o777, folder.stat().st_mode & 0o777) == (0o644, 0o755)


@pytest.mark.parametrize("name", ["lineside.db", "lineside.db.opening"])
def test_a_store_that_is_a_link_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(StoreError, match="is a link, which is not followed"):
        Database(tmp_path / "lineside.db")
    assert not (tmp_path / "elsewhere").exists()


@as_root
@pytest.mark.parametrize("name", ["", "lineside.db", "compiled/x"])
def test_files_of_another_user_are_refused(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "data"
    (folder / "compiled").mkdir(parents=True)
    for file in ("lineside.db", "compiled/x"):
        (folder / file).touch()
    os.chown(folder / name, 65534, 65534)
    with pytest.raises(StoreError, match=r"belongs to another user \(uid 65534\)"):
        make_private(folder)


@pytest.mark.parametrize("process", ["command", "worker"])
def test_a_process_begins_by_taking_the_rights_of_others(
    process: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also from what a library writes, of which nothing else here knows."""
    monkeypatch.setattr(cli, "cli", lambda **_: None)
    monkeypatch.delenv(parent.PARENT, raising=False)
    monkeypatch.setenv("PYDANTIC_DISABLE_PLUGINS", "__all__")
    monkeypatch.delenv(worker.TOKEN_VARIABLE, raising=False)
    before = os.umask(0)
    try:
        if process == "command":
            cli.main()
        else:
            assert worker.main(["--config", "none", "--bus", "none", "--app", "none"]) == worker.WRONG_USE
    finally:
        mask = os.umask(before)
    assert mask == 0o077
