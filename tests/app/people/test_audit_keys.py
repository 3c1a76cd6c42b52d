"""The key of the audit log: made once, for the server's user alone, and refused where others may know it."""

from __future__ import annotations

import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from app.errors import StoreError
from app.people.audit.entry import SITE, Head, KeyOrigin, KeyRing
from app.people.audit.keys import KeyFileError, Keys, open_keys
from app.settings import ConfigurationError, Settings, load

HEADS = {SITE: Head(7, "a" * 64)}


@pytest.fixture
def store(tmp_path: Path) -> Path:
    path = tmp_path / "lineside.db"
    path.touch()
    return path


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "lineside.audit.key"


def opened(path: Path, store: Path) -> Keys:
    return open_keys([path], store, HEADS)


def test_it_is_made_once_and_read_by_its_user_alone(path: Path, store: Path) -> None:
    made = opened(path, store).ring
    assert path.stat().st_mode & 0o777 == 0o600
    assert made.origin == KeyOrigin(7, "a" * 64)
    assert open_keys([path], store, {SITE: Head(9, "b" * 64)}).ring == made
    assert sorted(entry.name for entry in path.parent.iterdir()) == [path.name, store.name]


def test_two_processes_that_start_at_once_have_one_key(path: Path, store: Path) -> None:
    with ThreadPoolExecutor(8) as together:
        rings = list(together.map(lambda _: opened(path, store).ring, range(8)))
    assert len(set(rings)) == 1


def test_one_that_others_can_use_is_refused_with_what_to_do(path: Path, store: Path) -> None:
    opened(path, store)
    for mode in (0o640, 0o604, 0o620):
        path.chmod(mode)
        with pytest.raises(KeyFileError, match=r"by others, who may know it now; chmod 600 .* rotate-key"):
            opened(path, store)


def test_a_link_is_not_followed(path: Path, store: Path) -> None:
    opened(path, store)
    moved = path.with_name("elsewhere")
    path.rename(moved)
    path.symlink_to(moved)
    with pytest.raises(KeyFileError, match="it is a link, name the file itself"):
        opened(path, store)


def test_a_link_to_nowhere_is_not_taken_for_a_missing_file(path: Path, store: Path) -> None:
    path.symlink_to(path.with_name("nowhere"))
    with pytest.raises(KeyFileError):
        opened(path, store)
    assert not path.with_name("nowhere").exists()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file away")
def test_one_of_another_user_is_refused(path: Path, store: Path) -> None:
    opened(path, store)
    os.chown(path, 65534, 65534)
    with pytest.raises(KeyFileError, match="belongs to another user"):
        opened(path, store)
    os.chown(store, 65534, 65534)
    assert opened(path, store), "an auditor who is root reads the key of the server's user"


def test_a_folder_in_which_all_users_can_replace_it_is_refused(path: Path, store: Path) -> None:
    opened(path, store)
    path.parent.chmod(0o777)
    with pytest.raises(KeyFileError, match="every user can replace the audit key"):
        opened(path, store)
    path.parent.chmod(0o1777)
    opened(path, store)


def test_a_damaged_one_and_something_that_is_no_file_are_refused(path: Path, store: Path) -> None:
    path.touch(0o600)
    for content in (b"", b"{}", b'{"log":{"id":0,"hash":""},"keys":[]}', b"\xff", b"[" * 70_000):
        path.write_bytes(content)
        with pytest.raises(KeyFileError, match="is damaged"):
            opened(path, store)
    path.unlink()
    os.mkfifo(path, 0o600)
    with pytest.raises(KeyFileError, match="is not a file"):
        opened(path, store)


def test_a_place_where_none_can_be_made_is_reported(store: Path) -> None:
    with pytest.raises(StoreError, match=r"cannot be made: .*name another place as key_file in \[audit\]"):
        opened(store.parent / "nowhere" / "key", store)


def test_a_rotated_ring_is_read_again_by_who_meets_its_key(path: Path, store: Path) -> None:
    server, command = opened(path, store), opened(path, store)
    command.rotate()
    assert server.ring != command.ring
    assert server.knowing(command.ring.newest) == command.ring
    assert path.stat().st_mode & 0o777 == 0o600


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file away")
def test_a_rotation_by_root_leaves_the_file_to_its_user(path: Path, store: Path) -> None:
    opened(path, store)
    for file in (path, store):
        os.chown(file, 65534, 65534)
    opened(path, store).rotate()
    assert (path.stat().st_uid, path.stat().st_mode & 0o777) == (65534, 0o600)


def test_a_seal_holds_for_its_key_its_purpose_and_its_parts_alone() -> None:
    ring = KeyRing((b"a" * 32, b"b" * 32))
    seal = ring.seal("head", "1", "x")
    assert ring.confirms(seal, ring.newest, "head", "1", "x")
    assert ring.confirms_by_any(seal, "head", "1", "x")
    assert not ring.confirms(seal, ring.newest, "entry", "1", "x")
    assert not ring.confirms(seal, ring.newest, "head", "1", "y")
    assert not ring.confirms(seal, "unknown", "head", "1", "x")
    older = KeyRing(ring.keys[:1])
    assert not ring.confirms(older.seal("head", "1", "x"), ring.newest, "head", "1", "x")
    assert ring.confirms_by_any(older.seal("head", "1", "x"), "head", "1", "x")
    assert not ring.confirms("Ü" * 64, ring.newest, "head", "1", "x")


def written(folder: Path, text: str) -> Path:
    path = folder / "plant.toml"
    path.write_text(text)
    return path


def test_where_key_and_anchor_are(tmp_path: Path) -> None:
    settings = load(written(tmp_path, '[server]\ndata = "/var/lib/x"\n'))
    name = "plant.audit.key"
    assert settings.key_files == (tmp_path / name, Path("/var/lib") / name, Path("/var/lib/x") / name)
    assert settings.audit.anchor is None
    text = '[audit]\nkey_file = "keys/a.key"\nanchor = "/mnt/worm/a"\n'
    settings = load(written(tmp_path, text))
    assert settings.key_files == (tmp_path / "keys" / "a.key",)
    assert settings.audit.anchor == Path("/mnt/worm/a")
    settings = Settings.model_validate({"server": {"data": "/x/data"}})
    assert settings.key_files[0] == Path("/x/data.audit.key")


def test_a_service_that_can_write_to_its_data_folder_alone_has_its_key_there(store: Path) -> None:
    """Weaker than elsewhere, and reported at every start, but no reason to leave a machine without a
    dashboard.
    """
    nowhere = [store.parent / "nowhere" / "key", store.parent / "neither" / "key"]
    keys = open_keys([*nowhere, store.parent / "key"], store, HEADS)
    assert keys.path == store.parent / "key"
    nowhere[0].parent.mkdir()
    assert open_keys([*nowhere, store.parent / "key"], store, HEADS).ring == keys.ring, (
        "the key that there is"
    )


def test_a_key_in_the_data_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "here").symlink_to(tmp_path / "data")
    for file in ("data/deep/a.key", "here/a.key"):
        with pytest.raises(ConfigurationError, match=r"is in the data folder: .*name a file in another"):
            load(written(tmp_path, f'[audit]\nkey_file = "{file}"\n'))


def test_the_data_of_another_configuration_comes_without_its_key(tmp_path: Path) -> None:
    """A copy of the data folder elsewhere: there a new key is made, for the log as it is."""
    first, second = tmp_path / "one", tmp_path / "two"
    first.mkdir()
    (first / "lineside.db").touch()
    opened(tmp_path / "one.key", first / "lineside.db")
    shutil.copytree(first, second)
    other = open_keys([tmp_path / "two.key"], second / "lineside.db", {SITE: Head(3, "c" * 64)})
    assert other.ring.origin == KeyOrigin(3, "c" * 64)
