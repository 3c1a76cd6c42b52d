"""Files in the folder of the archive that another user has put there in place of ours."""

from __future__ import annotations

import gzip
import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from app.people.audit.archive import ArchiveProof, EventArchiveError
from tests.app.people.test_event_archive import Log, log

__all__ = ["log"]
FIRST, SECOND = "events-2026-01.jsonl.gz", "events-2026-01-2.jsonl.gz"
DEEP = '{"id": 1, "who": ' + "[" * 100_000 + "]" * 100_000 + "}\n"
REPLACED: dict[str, Callable[[Path], object]] = {
    "a line without an end": lambda path: path.write_bytes(gzip.compress(b" " * 8_000_000, 1)),
    "depth without an end": lambda path: path.write_bytes(gzip.compress(DEEP.encode())),
    "a file of the system": lambda path: path.symlink_to("/dev/zero"),
    "a link to itself": lambda path: path.symlink_to(path.name),
    "a pipe": os.mkfifo,
    "a folder": Path.mkdir,
}


@pytest.mark.parametrize("how", REPLACED)
async def test_a_file_that_was_replaced_is_named_and_none_ends_the_archive(log: Log, how: str) -> None:
    await log.five_months()
    REPLACED[how](log.folder / FIRST)
    await log.archive.archive_due()
    assert log.archive.failing is None
    assert [cut.file for cut in await log.cuts()] == [SECOND, "events-2026-02.jsonl.gz"]
    assert await log.prove() == ArchiveProof(12)
    second = log.folder / SECOND
    second.unlink()
    REPLACED[how](second)
    if second.exists():
        with pytest.raises(EventArchiveError, match=SECOND):
            await log.prove()
    else:
        assert await log.prove() == ArchiveProof(6, (SECOND,))
    assert (await log.verify()).broken is None


@pytest.mark.parametrize(
    "entry", [{"id": True, "hash": 1}, {"id": -1, "who": "\ud800", "time": 1e999}], ids=[0, 1]
)
async def test_an_entry_that_is_none_is_named(log: Log, entry: dict[str, object]) -> None:
    await log.five_months()
    await log.archive.archive_due()
    (log.folder / FIRST).write_bytes(gzip.compress(f"{json.dumps(entry)}\n".encode()))
    with pytest.raises(EventArchiveError, match=FIRST):
        await log.prove()


async def test_a_link_out_of_the_folder_is_not_followed(log: Log, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.write_text("theirs")
    (log.folder / FIRST).symlink_to(outside)
    await log.five_months()
    await log.archive.archive_due()
    assert outside.read_text() == "theirs"
    assert await log.prove() == ArchiveProof(12)
