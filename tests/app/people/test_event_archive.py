"""The archive of events: written and verified before anything is removed, and proven across the cut."""

from __future__ import annotations

import asyncio
import gzip
import json
import os
import shutil
from collections.abc import AsyncIterator
from datetime import datetime
from pathlib import Path
from zoneinfo import ZoneInfo

import pytest

from app.core.database import Database, StoreConnection
from app.core.database.connection import open_for_reading
from app.core.database.migration import MIGRATIONS
from app.errors import ConstraintError
from app.line.history.status import growth_of_events
from app.people.audit import archive as module
from app.people.audit import proof
from app.people.audit.anchor import Anchoring, read_anchor_file
from app.people.audit.archive import (
    ArchiveProof,
    EventArchive,
    EventArchiveError,
    Month,
    entries_in,
    month_of,
    months_due,
    prove_archive,
    write_file,
)
from app.people.audit.entry import KeyRing
from app.people.audit.keys import Keys
from app.people.audit.log import EventLog, Filter
from app.people.audit.proof import AuditVerification, Cut, add_cut, cuts_of
from bus.instants import UnixTime
from bus.messages import Message
from tests.app.intents import intend

BERLIN = ZoneInfo("Europe/Berlin")
RING = KeyRing((b"k" * 32,))
ENTRIES = 3
"""Commands of a month, each with its result."""


def moment(text: str) -> UnixTime:
    return UnixTime(datetime.fromisoformat(text).replace(tzinfo=BERLIN).timestamp())


class Log:
    """A log with its archive, whose clock is the test's."""

    def __init__(self, folder: Path) -> None:
        self.now = moment("2026-01-10T08:00")
        self.database = Database(folder / "lineside.db")
        self.keys = Keys(RING)
        self.events = EventLog(self.database, self.clock, self.keys)
        self.folder = folder / "archive"
        self.folder.mkdir()
        self.archive = self.started()

    def clock(self) -> UnixTime:
        return self.now

    def started(self, keep: int = 2) -> EventArchive:
        """The archive of a server that starts now."""
        return EventArchive(self.database, self.events, self.folder, keep, BERLIN, self.clock)

    async def happen(self, month: str, commands: int = ENTRIES) -> None:
        """Commands of a month on two buses, with their results."""
        self.now = moment(f"{month}-10T08:00")
        for number in range(commands):
            bus = "dry-end" if number % 2 else "wet-end"
            event = await intend(
                self.events, bus=bus, unit=1, who="änn", origin="page", what="set speed", new="50.0"
            )
            self.now += 1
            await self.events.conclude(event, "verified", "reads 50.0")

    async def five_months(self) -> None:
        for month in ("2026-01", "2026-02", "2026-03", "2026-04", "2026-05"):
            await self.happen(month)

    def files(self) -> list[str]:
        return sorted(path.name for path in self.folder.iterdir())

    async def cuts(self) -> list[Cut]:
        return await self.database.read(cuts_of)

    async def numbers(self) -> list[int]:
        query = "SELECT id FROM events ORDER BY id"
        return await self.database.read(lambda c: [row[0] for row in c.execute(query)])

    async def verify(self) -> AuditVerification:
        return await self.events.proof.verify()

    async def prove(self, folder: Path | None = None) -> ArchiveProof:
        return prove_archive(await self.cuts(), folder or self.folder, RING, {})

    async def failures(self) -> list[str]:
        page, _ = await self.events.page(Filter(code="event_archive_failed"), 10)
        return [event["message"] for event in page]


@pytest.fixture
async def log(tmp_path: Path) -> AsyncIterator[Log]:
    opened = Log(tmp_path)
    yield opened
    opened.database.close()


def test_a_month_is_due_once_the_kept_ones_after_it_are_over() -> None:
    def due(oldest: str, now: str, keep: int) -> list[str]:
        return [str(month) for month in months_due(moment(oldest), moment(now), keep, BERLIN)]

    assert due("2025-11-30T23:59", "2026-03-31T23:59", 2) == ["2025-11", "2025-12"]
    assert due("2025-11-30T23:59", "2026-01-31T23:59", 2) == []
    assert due("2026-03-01T00:00", "2025-03-01T00:00", 2) == []
    assert month_of(moment("2025-12-31T23:59"), BERLIN).after(1).begins(BERLIN) == moment("2026-01-01T00:00")


async def test_months_past_their_time_are_moved_into_a_file_each(log: Log) -> None:
    await log.five_months()
    await log.archive.archive_due()
    assert log.archive.failing is None
    assert log.files() == ["events-2026-01.jsonl.gz", "events-2026-02.jsonl.gz"]
    first = [*entries_in(log.folder / "events-2026-01.jsonl.gz")]
    assert [each["id"] for each in first] == [1, 2, 3, 4, 5, 6]
    assert (first[0]["who"], first[1]["outcome"]) == ("änn", "verified")
    assert (await log.numbers())[0] == 13
    page, _ = await log.events.page(Filter(code="event_archived"), 10)
    assert [event["what"] for event in page] == [
        "entries 7 to 12 archived in events-2026-02.jsonl.gz",
        "entries 1 to 6 archived in events-2026-01.jsonl.gz",
    ]


async def test_the_log_is_proven_across_the_cut(log: Log) -> None:
    await log.five_months()
    await log.archive.archive_due()
    verdict = await log.verify()
    assert (verdict.broken, verdict.archived, verdict.entries) == (None, 12, 32)
    assert await log.prove() == ArchiveProof(12)
    await log.happen("2026-06")
    await log.archive.archive_due()
    assert (await log.verify()).broken is None
    assert await log.prove() == ArchiveProof(18)


async def test_a_month_that_is_archived_during_a_verification_is_no_alteration(
    log: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    await log.five_months()
    loop, chunks = asyncio.get_running_loop(), 0

    def archive_during_the_third_chunk(statement: str) -> None:
        nonlocal chunks
        chunks += statement.startswith("SELECT * FROM events WHERE id >=")
        if chunks == 3:
            chunks += 1
            asyncio.run_coroutine_threadsafe(log.archive.archive_due(), loop).result()

    def opened(path: Path) -> StoreConnection:
        connection = open_for_reading(path)
        connection.set_trace_callback(archive_during_the_third_chunk)
        return connection

    monkeypatch.setattr(proof, "CHUNK", 2)
    monkeypatch.setattr(proof, "open_for_reading", opened)
    verdict = await log.verify()
    assert (verdict.fault, verdict.archived) == (None, 12)


async def test_without_its_files_the_store_is_proven_from_the_cut(log: Log, tmp_path: Path) -> None:
    await log.five_months()
    await log.archive.archive_due()
    names = tuple(log.files())
    assert await log.prove(tmp_path / "elsewhere") == ArchiveProof(0, names)
    (log.folder / names[0]).unlink()
    assert await log.prove() == ArchiveProof(6, names[:1])
    assert (await log.verify()).broken is None


async def test_nothing_is_archived_before_its_time(log: Log) -> None:
    await log.happen("2026-01")
    await log.happen("2026-03")
    await log.archive.archive_due()
    assert (log.files(), await log.cuts()) == ([], [])


async def test_without_a_folder_all_events_stay(log: Log) -> None:
    await log.five_months()
    await EventArchive(log.database, log.events, None, 1, BERLIN, log.clock).archive_due()
    assert (await log.numbers())[0] == 1


async def test_an_event_is_not_removed_before_it_is_archived(log: Log) -> None:
    await log.five_months()
    await log.archive.archive_due()
    with pytest.raises(ConstraintError):
        await log.database.write(lambda c: c.execute("DELETE FROM events WHERE id = 13"))
    with pytest.raises(ConstraintError):
        await log.database.write(lambda c: c.execute("DELETE FROM events_archive"))


async def test_a_missing_folder_removes_nothing_and_is_reported_once(log: Log) -> None:
    log.folder.rmdir()
    await log.five_months()
    for _ in range(2):
        await log.archive.archive_due()
    assert log.archive.failing is not None
    assert log.archive.failing.code == "audit_archive_folder_missing"
    [failure] = await log.failures()
    assert str(log.folder) in failure
    assert (await log.numbers())[0] == 1
    log.folder.mkdir()
    await log.archive.archive_due()
    assert log.archive.failing is None
    assert (await log.numbers())[0] == 13


async def test_a_full_disk_leaves_nothing_and_removes_nothing(
    log: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_file: int) -> None:
        raise OSError(28, "No space left on device")

    await log.five_months()
    with monkeypatch.context() as disk:
        disk.setattr(module.os, "fsync", full)
        await log.archive.archive_due()
    assert log.archive.failing is not None
    assert (log.files(), await log.cuts(), (await log.numbers())[0]) == ([], [], 1)


async def test_a_file_that_an_ended_server_left_is_removed_after_a_day(log: Log) -> None:
    await log.five_months()
    old, new = log.folder / ".events-2026-01.0", log.folder / ".events-2026-01.1"
    for left in (old, new):
        left.touch()
    os.utime(old, (1.0, 1.0))
    await log.archive.archive_due()
    assert log.files() == [new.name, "events-2026-01.jsonl.gz", "events-2026-02.jsonl.gz"]


async def test_a_server_that_ended_before_the_cut_writes_the_same_file(log: Log) -> None:
    await log.five_months()
    written = log.folder / "events-2026-01.jsonl.gz"
    query = "SELECT * FROM events WHERE id <= 6 ORDER BY id"
    entries = await log.database.read(lambda c: [dict(row) for row in c.execute(query)])
    write_file(log.folder, Month(2026, 1), [entries])
    before = written.read_bytes()
    await log.started().archive_due()
    assert written.read_bytes() == before
    assert log.files() == ["events-2026-01.jsonl.gz", "events-2026-02.jsonl.gz"]
    assert await log.prove() == ArchiveProof(12)


async def test_a_server_that_ended_during_the_removal_goes_on_with_it(
    log: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    await log.five_months()
    monkeypatch.setattr(module, "MAX_REMOVED", 2)
    steps = 0

    class EndedError(Exception):
        pass

    def ended(connection: StoreConnection, remove=module._remove_some) -> bool:  # type: ignore[no-untyped-def]
        nonlocal steps
        steps += 1
        if steps == 3:
            raise EndedError
        return bool(remove(connection))

    monkeypatch.setattr(module, "_remove_some", ended)
    with pytest.raises(EndedError):
        await log.archive.archive_due()
    assert (await log.numbers())[:3] == [1, 2, 7]
    assert (await log.verify()).broken is None
    assert await log.prove() == ArchiveProof(6)
    await log.started().archive_due()
    assert (await log.numbers())[0] == 13
    assert log.files() == ["events-2026-01.jsonl.gz", "events-2026-02.jsonl.gz"]
    assert (await log.verify()).broken is None


async def test_a_command_and_its_result_are_never_parted(log: Log) -> None:
    await log.happen("2026-01")
    log.now = moment("2026-01-31T23:59:59")
    late = await intend(log.events, bus="dry-end", unit=1, who="ann", origin="api", what="set speed")
    log.now = moment("2026-02-01T00:00:01")
    await log.events.record(kind="unit", what="offline", bus="dry-end", unit=2)
    await log.events.conclude(late, "verified")
    for month in ("2026-03", "2026-04"):
        await log.happen(month)
    await log.archive.archive_due()
    assert [each["id"] for each in entries_in(log.folder / "events-2026-01.jsonl.gz")] == [1, 2, 3, 4, 5, 6]
    assert (await log.numbers())[:3] == [7, 8, 9]
    await log.happen("2026-06")
    await log.archive.archive_due()
    assert (await log.numbers())[0] == 16
    assert (await log.verify()).broken is None
    assert (await log.prove()).absent == ()


async def test_an_event_of_a_clock_that_was_ahead_does_not_end_the_archive(log: Log) -> None:
    await log.happen("2026-01")
    await log.happen("2027-01", 1)
    for month in ("2026-02", "2026-03", "2026-04", "2026-05"):
        await log.happen(month)
    await log.archive.archive_due()
    assert log.files() == ["events-2026-01.jsonl.gz", "events-2026-02.jsonl.gz"]
    assert (await log.verify()).broken is None


async def test_a_clock_that_is_ahead_leaves_the_newest_events(log: Log) -> None:
    await log.happen("2026-01")
    log.now = moment("2027-01-10T08:00")
    await log.archive.archive_due()
    assert log.files() == []


@pytest.mark.parametrize("content", [b"", b"{}\n", b"no json\n", None])
async def test_a_damaged_file_is_named(log: Log, content: bytes | None) -> None:
    await log.five_months()
    await log.archive.archive_due()
    file = log.folder / "events-2026-01.jsonl.gz"
    file.write_bytes(file.read_bytes()[:-20] if content is None else gzip.compress(content))
    with pytest.raises(EventArchiveError, match="events-2026-01"):
        await log.prove()
    assert (await log.verify()).broken is None


async def test_a_changed_entry_of_a_file_is_named(log: Log) -> None:
    await log.five_months()
    await log.archive.archive_due()
    file = log.folder / "events-2026-01.jsonl.gz"
    lines = [json.loads(line) for line in gzip.decompress(file.read_bytes()).splitlines()]
    lines[2]["who"] = "bob"
    file.write_bytes(gzip.compress("".join(f"{json.dumps(line)}\n" for line in lines).encode()))
    with pytest.raises(EventArchiveError, match="entry 3"):
        await log.prove()


async def test_a_file_of_another_log_takes_no_place(log: Log) -> None:
    await log.five_months()
    former = log.folder / "events-2026-01.jsonl.gz"
    former.write_bytes(b"of the log before a restore")
    await log.archive.archive_due()
    assert former.read_bytes() == b"of the log before a restore"
    assert [cut.file for cut in await log.cuts()] == ["events-2026-01-2.jsonl.gz", "events-2026-02.jsonl.gz"]
    assert await log.prove() == ArchiveProof(12)


async def test_a_cut_without_the_key_proves_nothing(log: Log) -> None:
    await log.five_months()
    cut = Cut(6, 1, "events-2026-01.jsonl.gz", "0" * 64, "0" * 64, "{}", log.now)
    forged = cut.sealed(KeyRing((b"s" * 32,)))
    await log.database.write(lambda c: add_cut(c, forged))
    await log.database.write(module._remove_some)
    assert (await log.verify()).broken == 1
    with pytest.raises(EventArchiveError, match="not written with the key"):
        await log.prove()
    await log.archive.archive_due()
    assert log.archive.failing == Message.of("audit_archive_forged", file=cut.file)


async def test_an_altered_log_is_not_archived(log: Log) -> None:
    await log.five_months()
    # Without the key no entry can be added behind the last one that was.
    log.keys.ring = KeyRing((b"o" * 32,))
    await log.archive.archive_due()
    assert log.archive.failing is not None
    assert log.archive.failing.code == "audit_archive_of_altered"
    assert (log.files(), (await log.numbers())[0]) == ([], 1)


async def test_an_anchor_of_before_the_cut_is_continued(log: Log, tmp_path: Path) -> None:
    anchor = tmp_path / "anchor"
    await log.happen("2026-01")
    await Anchoring(log.events, anchor, log.clock).export()
    for month in ("2026-02", "2026-03", "2026-04", "2026-05"):
        await log.happen(month)
    running = Anchoring(log.events, tmp_path / "other", log.clock)
    await running.export()
    await log.archive.archive_due()
    started = Anchoring(log.events, anchor, log.clock)
    for each in (started, running):
        await each.export()
        assert each.status.altered is None
    heads = read_anchor_file(anchor, RING).hashes
    assert prove_archive(await log.cuts(), log.folder, RING, heads) == ArchiveProof(12)
    assert (await log.events.proof.verify(heads)).broken is None


async def test_an_archived_entry_that_an_anchor_contradicts_is_named(log: Log) -> None:
    await log.five_months()
    await log.archive.archive_due()
    with pytest.raises(EventArchiveError, match="entry 4 is not the one that the anchor names"):
        prove_archive(await log.cuts(), log.folder, RING, {4: "0" * 64})


async def test_the_entry_of_a_signature_stays_and_is_verified(log: Log) -> None:
    def sign(connection: StoreConnection) -> None:
        connection.execute("INSERT INTO shift_sheet VALUES (0, 1, ?, '', ?, '')", (b"", b""))
        connection.execute("INSERT INTO shift_signature VALUES (0, 'leaving', 'ann', 0, 1)")

    await log.events.record(kind="shift", what="signed over", also=sign)
    await log.five_months()
    await log.archive.archive_due()
    assert (await log.numbers())[:2] == [1, 14]
    assert (await log.verify()).broken is None
    await log.database.write(lambda c: c.execute("DROP TRIGGER events_stay_as_written"))
    await log.database.write(lambda c: c.execute("UPDATE events SET who = 'bob' WHERE id = 1"))
    assert (await log.verify()).broken == 1


async def test_a_store_of_before_the_archive_gets_one(tmp_path: Path) -> None:
    """The rule that no event is removed is replaced, on each engine."""
    steps = tmp_path / "steps"
    steps.mkdir()
    file = tmp_path / "older.db"
    for step in MIGRATIONS.glob("*.sql"):
        if step.name < "0190":
            (steps / step.name).write_text(step.read_text())
    former = Database(file, steps)
    events = EventLog(former, keys=Keys(RING))
    await intend(events, bus="dry-end", unit=1, who="ann", origin="api", what="set speed")
    former.close()
    shutil.copy(MIGRATIONS / "0190_events_archive.sql", steps)
    database = Database(file, steps)
    with pytest.raises(ConstraintError):
        await database.write(lambda c: c.execute("DELETE FROM events"))
    cut = Cut(1, 1, "f", "", "", "{}", UnixTime(1.0)).sealed(RING)
    await database.write(lambda c: add_cut(c, cut))
    await database.write(lambda c: c.execute("DELETE FROM events"))
    database.close()


async def test_the_forecast_knows_that_archived_events_make_room(log: Log) -> None:
    def growth(*, is_archived: bool) -> float:
        return log.database.read_now(lambda c: growth_of_events(c, 1000, is_archived=is_archived))

    await log.five_months()
    assert growth(is_archived=True) == growth(is_archived=False) == pytest.approx(1000 / 120, rel=0.01)
    await log.archive.archive_due()
    assert (growth(is_archived=True), growth(is_archived=False)) == (0.0, pytest.approx(1000 / 61, rel=0.01))
