"""Disk space that is kept for commands: made while there is enough, given up, and made again."""

from __future__ import annotations

import errno
import os
from contextlib import closing
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from app.core.database import Database, files
from app.core.database.files import FILE, MIN_FREE, MIN_FREE_OF_OTHERS, Reserve

SIZE = 8_000_000


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """How many bytes are free."""
    free = {"bytes": 10 * MIN_FREE_OF_OTHERS}
    monkeypatch.setattr(files, "free_bytes", lambda _: free["bytes"])
    return free


def held(folder: Path) -> int:
    """The bytes that are really allocated."""
    return (folder / FILE).stat().st_blocks * 512


@pytest.mark.usefixtures("disk")
def test_the_space_is_allocated_at_the_start(tmp_path: Path) -> None:
    made = Reserve(tmp_path, SIZE)
    assert held(tmp_path) >= SIZE
    assert (tmp_path / FILE).stat().st_mode & 0o077 == 0
    assert (made.left, made.notice) == (1.0, None)


def test_a_small_disk_keeps_half_of_what_it_has(tmp_path: Path, disk: dict[str, int]) -> None:
    disk["bytes"] = SIZE
    made = Reserve(tmp_path, SIZE)
    assert (tmp_path / FILE).stat().st_size == SIZE // 2
    disk["bytes"] = SIZE // 2
    made.close()
    assert Reserve(tmp_path, SIZE).left == 0.5, "nor does it lose that at the next start"
    disk["bytes"] = 10 * MIN_FREE_OF_OTHERS
    assert made.notice is not None
    made.keep()
    assert (made.left, made.notice) == (1.0, None)


def test_before_a_transaction_as_much_is_given_up_as_it_may_need(
    tmp_path: Path, disk: dict[str, int]
) -> None:
    made = Reserve(tmp_path, SIZE)
    disk["bytes"] = MIN_FREE
    made.keep()
    assert made.left == 1.0
    disk["bytes"] = 500_000
    made.keep()
    assert (tmp_path / FILE).stat().st_size == SIZE - MIN_FREE + 500_000
    assert made.left == pytest.approx((SIZE - MIN_FREE + 500_000) / SIZE)
    assert made.notice is not None
    disk["bytes"] = 0
    for _ in range(9):
        made.keep()
    assert (made.left, (tmp_path / FILE).stat().st_size) == (0.0, 0)


def test_it_is_made_again_where_history_has_room_too(tmp_path: Path, disk: dict[str, int]) -> None:
    made = Reserve(tmp_path, SIZE)
    for free, left in ((0, 0.75), (MIN_FREE_OF_OTHERS, 0.75), (MIN_FREE_OF_OTHERS + SIZE, 1.0)):
        disk["bytes"] = free
        made.keep()
        assert made.left == left


def test_a_store_keeps_it_with_each_transaction(tmp_path: Path, disk: dict[str, int]) -> None:
    made = Reserve(tmp_path, SIZE)
    with closing(Database(tmp_path / "store.db", reserve=made)) as database:
        disk["bytes"] = 0
        database.write_now(lambda connection: connection.execute("CREATE TABLE one (number)"))
    assert made.left == 0.75


def test_the_end_gives_it_back_unless_the_disk_is_short(tmp_path: Path, disk: dict[str, int]) -> None:
    made = Reserve(tmp_path, SIZE)
    disk["bytes"] = MIN_FREE_OF_OTHERS - 1
    made.close()
    assert held(tmp_path) >= SIZE
    made = Reserve(tmp_path, SIZE)
    assert made.left == 1.0, "the rest of the run before is taken over"
    disk["bytes"] = MIN_FREE_OF_OTHERS
    made.close()
    assert not (tmp_path / FILE).exists()


@pytest.mark.usefixtures("disk")
def test_a_disk_that_cannot_allocate_is_reported_once_and_stops_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with capture_logs() as logs:
        made = Reserve(tmp_path, SIZE)
        made.keep()
    assert [entry["error"] for entry in logs] == ["[Errno 28] No space left on device"]
    assert (made.left, (tmp_path / FILE).stat().st_size) == (0.0, 0)


def test_a_folder_that_is_gone_does_not_stop_a_transaction(tmp_path: Path) -> None:
    made = Reserve(tmp_path / "data", SIZE)
    (tmp_path / "data" / FILE).unlink()
    (tmp_path / "data").rmdir()
    made.keep()
    made.close()
