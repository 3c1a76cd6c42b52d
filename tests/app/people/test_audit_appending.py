"""Each event continues the one chain of its site; old stores go on."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import pytest

from app.core.database import Database, StoreConnection
from app.core.database.migration import MIGRATIONS
from app.people.audit import log as appending
from app.people.audit.anchor import Anchoring, read_anchors
from app.people.audit.archive import EventArchive, Month, prove_archive
from app.people.audit.entry import (
    BEGINNING,
    JOINED,
    SITE,
    Head,
    KeyOrigin,
    KeyRing,
    entry_hash,
    new_entry,
    origin_of,
    sealed_entry,
    sealed_head,
)
from app.people.audit.keys import Keys, open_keys, passing_keys
from app.people.audit.log import EventLog
from app.people.audit.proof import cuts_of, heads_of, newest_cut, prove
from bus.instants import UnixTime
from tests.app.former_log import DRY, WET, FormerLog
from tests.app.intents import intend

RING = KeyRing((b"k" * 32,))


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Database]:
    with closing(Database(tmp_path / "lineside.db")) as database:
        yield database


@pytest.fixture
def former(store: Database) -> FormerLog:
    made = FormerLog(store, RING)
    made.work()
    return made


def rows(database: Database) -> list[dict[str, Any]]:
    return database.read_now(lambda c: [dict(row) for row in c.execute("SELECT * FROM events ORDER BY id")])


def intent(bus: str, unit: int = 1) -> dict[str, Any]:
    return {"who": "ann", "origin": "api", "bus": bus, "unit": unit, "what": "set speed"}


async def test_events_of_all_buses_and_their_outcomes_are_in_one_chain(store: Database) -> None:
    log = EventLog(store)
    await log.record(kind="login", what="signed in")
    number = await intend(log, **intent(DRY))
    await log.record(kind="estop", what="e-stop", bus=WET)
    await log.conclude(number, "verified")
    numbers = await log.intend_together([intent(DRY, unit) for unit in (1, 2, 3)])
    await log.conclude_together(dict.fromkeys(numbers, ("verified", "")))
    found = rows(store)
    assert [row["id"] for row in found] == list(range(1, 11))
    assert [row["previous"] for row in found] == [BEGINNING, *(row["hash"] for row in found[:-1])]
    verdict = await log.proof.verify()
    assert (verdict.broken, verdict.entries) == (None, 10)


async def test_a_program_that_meets_a_newer_key_goes_on(store: Database) -> None:
    one, other = EventLog(store, keys=Keys(RING)), EventLog(store, keys=Keys(RING.with_key(b"n" * 32)))
    await one.record(kind="login", what="signed in")
    await other.record(kind="login", what="signed in")
    assert store.read_now(lambda c: prove(c, other.keys.ring, {})).broken is None


async def test_entries_of_one_transaction_are_noted_once(store: Database) -> None:
    entries = [new_entry(kind="estop", time=float(number), what="x", bus=DRY) for number in range(1, 4)]
    keys = passing_keys()
    assert store.write_now(lambda c: appending.append(c, entries, keys)) == [1, 2, 3]
    assert store.write_now(lambda c: appending.append(c, [], keys)) == []
    assert {chain: head.id for chain, head in store.read_now(heads_of).items()} == {SITE: 3}


async def test_the_chains_of_a_former_log_go_on_as_one(store: Database, former: FormerLog) -> None:
    assert store.read_now(lambda c: prove(c, RING, {})).broken is None, "as it is"
    log = EventLog(store, keys=Keys(RING))
    assert await log.record(kind="estop", what="new", bus=WET) == 11
    await log.record(kind="login", what="new")
    joining = rows(store)[9]
    assert joining["what"] == str(JOINED)
    for chain, head in former.ends.items():
        assert f"ended with entry {head.id}, {head.hash}" in joining["message"]
        assert (f"the chain of {chain} " if chain else "the chain of the site ") in joining["message"]
    assert [row["chain"] for row in rows(store)[9:]] == [None] * 3
    verdict = await log.proof.verify()
    assert (verdict.broken, verdict.entries) == (None, 12)
    log.keys.rotate()
    await log.record(kind="login", what="newer")
    assert (await log.proof.verify()).broken is None


async def test_a_former_log_of_the_site_alone_goes_on_without_a_word(store: Database) -> None:
    former = FormerLog(store, RING)
    former.record()
    log = EventLog(store, keys=Keys(RING))
    assert await log.record(kind="login", what="new") == 2
    assert (await log.proof.verify()).broken is None


async def test_the_anchor_of_a_former_log_is_continued(
    store: Database, former: FormerLog, tmp_path: Path
) -> None:
    anchor = tmp_path / "anchor"
    anchor.write_bytes(former.anchor_line())
    log = EventLog(store, keys=Keys(RING))
    await log.record(kind="estop", what="new", bus=DRY)
    anchoring = Anchoring(log, anchor)
    await anchoring.export()
    assert anchoring.status.altered is None
    anchors = read_anchors(anchor.read_bytes().splitlines(), RING)
    assert (sorted(anchors.hashes), anchors.forged) == ([7, 8, 9, 11], None)
    assert (await log.proof.verify(anchors.hashes)).anchored == 11
    assert (await anchoring.verify()).anchored == 11
    assert (await log.proof.since(Head(9, anchors.hashes[9]))).broken is None


@pytest.mark.parametrize("forge", [(b"dry-end", b"wet-end2"), (b"[9,", b"[3,")])
def test_a_chain_of_a_line_of_a_former_anchor_is_sealed_with_it(
    former: FormerLog, forge: tuple[bytes, bytes]
) -> None:
    assert read_anchors([former.anchor_line()], RING).forged is None
    assert read_anchors([former.anchor_line().replace(*forge)], RING).forged == 1


async def test_the_archive_of_a_former_log_is_continued(
    store: Database, former: FormerLog, tmp_path: Path
) -> None:
    former.archive(tmp_path, Month(2001, 9))
    former.record(WET, what="after the cut")
    former.rotate(b"n" * 32)
    now = UnixTime(1e9 + 400 * 86_400.0)
    log = EventLog(store, lambda: now, keys=Keys(former.ring))
    assert (await log.proof.verify()).archived == 9
    await log.record(kind="login", what="new")
    await EventArchive(store, log, tmp_path, 2, ZoneInfo("UTC"), lambda: now).archive_due()
    verdict = await log.proof.verify()
    assert (verdict.broken, verdict.archived) == (None, 13)
    await log.record(kind="login", what="after the cut")
    assert (await log.proof.verify()).broken is None
    proof = prove_archive(store.read_now(cuts_of), tmp_path, former.ring, {})
    assert (proof.entries, proof.absent) == (13, ())
    cut = store.read_now(lambda c: newest_cut(c, former.ring))
    assert cut is not None
    assert set(cut.ends) == {SITE, DRY, WET}, "the month ends before the chains go on as one"


def before_chains(folder: Path) -> Path:
    """The steps up to the one before the chains."""
    folder.mkdir()
    for step in MIGRATIONS.glob("*.sql"):
        if step.name < "0140":
            shutil.copy(step, folder)
    return folder


def old_log(connection: StoreConnection, ring: KeyRing | None) -> Head:
    """Three entries as the first versions wrote them; without a ring, as those before the key."""
    previous = BEGINNING
    for number in (1, 2, 3):
        row = {**new_entry(kind="estop", time=float(number), what="old", bus=DRY), "id": number}
        if ring is None:
            row |= {"previous": previous, "hash": entry_hash(previous, row)}
        else:
            row = sealed_entry(previous, row, ring)
        previous = row["hash"]
        marks = ", ".join("?" * len(row))
        connection.execute(f"INSERT INTO events ({', '.join(row)}) VALUES ({marks})", [*row.values()])
    head = Head(3, previous) if ring is None else sealed_head(row, ring)
    end = (1, head.id, head.hash, head.key, head.seal)
    connection.execute("INSERT INTO events_head (only, id, hash, key, seal) VALUES (?, ?, ?, ?, ?)", end)
    return head


@pytest.mark.parametrize("is_sealed", [True, False])
async def test_the_chain_of_the_first_versions_goes_on(tmp_path: Path, is_sealed: bool) -> None:
    path = tmp_path / "lineside.db"
    with closing(Database(path, before_chains(tmp_path / "steps"))) as old:
        head = old.write_now(lambda c: old_log(c, RING if is_sealed else None))
        assert old.read_now(heads_of) == {SITE: head}
        ring = KeyRing(RING.keys, KeyOrigin() if is_sealed else KeyOrigin(head.id, head.hash))
        verdict = old.read_now(lambda c: prove(c, ring, {3: head.hash}))
        assert (verdict.broken, verdict.entries) == (None, 3), "the command reads it as it is"
    with closing(Database(path)) as database:
        assert database.read_now(heads_of) == {SITE: head}
        log = EventLog(database, keys=Keys(ring))
        first = await log.record(kind="estop", what="new", bus=DRY)
        assert first == (4 if is_sealed else 5), "an entry states from where on the log is sealed"
        verdict = await log.proof.verify({3: head.hash})
        assert (verdict.broken, verdict.unsealed) == (None, 0 if is_sealed else 3)


def test_the_file_of_a_key_notes_where_every_chain_of_a_former_log_ended(
    former: FormerLog, tmp_path: Path
) -> None:
    store, file = tmp_path / "lineside.db", tmp_path / "audit.key"
    made = open_keys([file], store, former.ends)
    made.rotate()
    read = open_keys([file], store, {}).ring.origin
    assert read == origin_of(former.ends)
    assert read.hashes == {head.id: head.hash for head in former.ends.values()}
