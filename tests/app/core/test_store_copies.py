"""Of each kind of copy of a store the newest two stay."""

from __future__ import annotations

from pathlib import Path

import pytest
from structlog.testing import capture_logs

from app.core.database import Database
from app.core.database import migration as copies
from app.core.database.migration import copy_of, put_aside, remove_older_copies


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_newest_two_stay_with_their_companions(tmp_path: Path) -> None:
    store = tmp_path / "x.db"
    store.touch()
    (tmp_path / "y.db.damaged-20250101T000000Z").touch()
    copy_of(store, "before", "0001").touch()
    for day in range(1, 5):
        for suffix in ("", "-wal"):
            copy_of(store, "damaged", f"2026010{day}T000000Z{suffix}").touch()
    remove_older_copies(store, "damaged")
    assert names_in(tmp_path) == [
        "x.db",
        "x.db.before-0001",
        *(f"x.db.damaged-2026010{day}T000000Z{suffix}" for day in (3, 4) for suffix in ("", "-wal")),
        "y.db.damaged-20250101T000000Z",
    ]


def test_one_that_cannot_be_removed_stays_and_is_logged(tmp_path: Path) -> None:
    store = tmp_path / "x.db"
    for label in ("1", "2", "3", "4"):
        copy_of(store, "before", label).touch()
    copy_of(store, "before", "1").unlink()
    copy_of(store, "before", "1").mkdir()
    with capture_logs() as logs:
        remove_older_copies(store, "before")
    assert names_in(tmp_path) == ["x.db.before-1", "x.db.before-3", "x.db.before-4"]
    assert [entry["path"] for entry in logs] == [str(copy_of(store, "before", "1"))]


def test_each_step_leaves_the_newest_two(tmp_path: Path) -> None:
    steps = tmp_path / "steps"
    steps.mkdir()
    for number in range(1, 6):
        (steps / f"{number:04d}_step.sql").write_text(f"CREATE TABLE t{number} (x INTEGER);\n")
        Database(tmp_path / "x.db", steps).close()
    assert [path.name for path in sorted(tmp_path.glob("x.db.*-*"))] == [
        "x.db.before-0004",
        "x.db.before-0005",
    ]


def test_a_store_put_aside_again_and_again_leaves_the_newest_two(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = tmp_path / "history.db"
    for minute in range(4):
        stamp = f"20260101T00{minute:02d}00Z"
        monkeypatch.setattr(copies.time, "strftime", lambda *_, stamp=stamp: stamp)
        store.write_text(stamp)
        assert put_aside(store).read_text() == stamp
    assert names_in(tmp_path) == [f"history.db.damaged-20260101T00{minute:02d}00Z" for minute in (2, 3)]
