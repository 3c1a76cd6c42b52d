"""Whether a store is in its place, and whether a server may start on it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from app.core.database import Database
from app.core.database.connection import examining
from app.core.database.migration import Presence, presence_of, refusal_to_start
from app.errors import StoreError

STORE, KEY = Path("/data/lineside.db"), Path("/etc/lineside.audit.key")


@pytest.mark.parametrize(
    ("presence", "key", "code"),
    [
        ("sound", KEY, None),
        ("sound", None, None),
        ("missing", None, None),
        ("empty", None, None),
        ("missing", KEY, "store_missing_at_start"),
        ("empty", KEY, "store_empty_at_start"),
        ("damaged", KEY, "store_damaged_at_start"),
        ("damaged", None, "store_damaged_at_start"),
    ],
)
def test_a_site_that_was_there_is_not_replaced(
    presence: Presence, key: Path | None, code: str | None
) -> None:
    refusal = refusal_to_start(str(STORE), presence, key, new=False)
    assert (refusal and refusal.code) == code
    assert refusal is None or "lineside serve --new" in str(refusal)


@pytest.mark.parametrize("key", [None, KEY])
@pytest.mark.parametrize(
    ("presence", "code"),
    [("sound", "store_not_new"), ("missing", None), ("empty", None), ("damaged", None)],
)
def test_a_new_site_is_begun_where_none_can_be_used(
    presence: Presence, code: str | None, key: Path | None
) -> None:
    refusal = refusal_to_start(str(STORE), presence, key, new=True)
    assert (refusal and refusal.code) == code


@pytest.fixture
def store(tmp_path: Path) -> Path:
    path = tmp_path / "data" / "lineside.db"
    Database(path).close()
    return path


def files_beside(store: Path) -> set[str]:
    return {path.name for path in store.parent.iterdir()}


def test_a_store_is_read_and_no_file_is_made(store: Path) -> None:
    before = files_beside(store)
    assert presence_of(store) == "sound"
    with examining(store) as connection:
        assert connection.execute("SELECT count(*) FROM events").fetchone()[0] == 0
    assert files_beside(store) == before


def test_a_store_that_a_server_has_open_is_read_with_its_log(store: Path) -> None:
    database = Database(store)
    database.write_now(lambda connection: connection.execute("CREATE TABLE newest (a)"))
    try:
        with examining(store) as connection:
            assert connection.execute("SELECT count(*) FROM newest").fetchone()[0] == 0
    finally:
        database.close()


def test_what_else_is_in_its_place(store: Path) -> None:
    size = store.stat().st_size
    os.truncate(store, size // 2)
    assert presence_of(store) == "damaged"
    os.truncate(store, 0)
    assert presence_of(store) == "empty"
    store.write_bytes(b"no store " * 1000)
    assert presence_of(store) == "damaged"
    store.unlink()
    assert presence_of(store) == "missing"
    assert presence_of(store.parent.parent / "unmounted" / "lineside.db") == "missing"


def test_a_link_is_not_followed(store: Path, tmp_path: Path) -> None:
    (tmp_path / "link.db").symlink_to(store)
    with pytest.raises(StoreError, match="link"):
        presence_of(tmp_path / "link.db")
