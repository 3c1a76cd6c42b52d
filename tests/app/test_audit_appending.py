"""Each event is in the chain of its bus or of the site, under a number over all chains; old stores go on."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from app.audit.events import appending
from app.audit.events.entry import new_entry
from app.audit.events.store import heads_of, prove
from app.audit.log import EventLog
from app.audit.proof.anchor import Anchors, anchor_line, joined_heads, newest_anchor, read_anchors
from app.audit.proof.anchoring import Anchoring
from app.audit.proof.chain import SITE, Head, entry_hash, origin_of, sealed_entry, sealed_head
from app.audit.proof.keyring import BEGINNING, KeyOrigin, KeyRing
from app.audit.proof.keys import Keys, open_keys, passing_keys
from app.database import Database, StoreConnection
from app.database.migration import MIGRATIONS
from tests.app.intents import intend

DRY, WET = "dry-end", "wet-end"
RING = KeyRing((b"k" * 32,))


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Database]:
    with closing(Database(tmp_path / "lineside.db")) as database:
        yield database


def chains(database: Database) -> list[tuple[int, str | None]]:
    rows = database.read_now(lambda c: c.execute("SELECT id, chain FROM events ORDER BY id").fetchall())
    return [(number, chain) for number, chain in rows]


def intent(bus: str, unit: int = 1) -> dict[str, Any]:
    return {"who": "ann", "origin": "api", "bus": bus, "unit": unit, "what": "set speed"}


async def test_an_event_and_its_outcome_are_in_the_chain_of_its_bus(store: Database) -> None:
    log = EventLog(store)
    await log.record(kind="login", what="signed in")
    number = await intend(log, **intent(DRY))
    await log.record(kind="estop", what="e-stop", bus=WET)
    await log.conclude(number, "verified")
    assert chains(store) == [(1, SITE), (2, DRY), (3, WET), (4, DRY)]
    verdict = await log.proof.verify({})
    assert verdict.broken is None
    assert [(chain.bus, chain.entries) for chain in verdict.chains] == [(None, 1), (DRY, 2), (WET, 1)]


async def test_a_change_of_a_group_is_in_the_chain_of_its_bus(store: Database) -> None:
    log = EventLog(store)
    numbers = await log.intend_together([intent(DRY, unit) for unit in (1, 2, 3)])
    await log.conclude_together(dict.fromkeys(numbers, ("verified", "")))
    assert chains(store) == [(number, DRY) for number in range(1, 7)]
    assert (await log.proof.verify({})).broken is None


async def test_commands_of_several_buses_are_concluded_each_in_its_chain(store: Database) -> None:
    log = EventLog(store)
    numbers = await log.intend_together([intent(DRY), intent(WET), intent(DRY)])
    await log.conclude_together(dict.fromkeys(numbers, ("verified", "")))
    assert [chain for _, chain in chains(store)] == [DRY, WET, DRY] * 2
    assert (await log.proof.verify({})).broken is None


async def test_two_servers_append_to_one_store_by_turns(store: Database) -> None:
    """Each has read the keys for itself; one of them meets a newer key."""
    one, other = EventLog(store, keys=Keys(RING)), EventLog(store, keys=Keys(RING))
    for number in range(4):
        await (one, other)[number % 2].record(
            kind="estop", what=f"e-stop {number}", bus=(DRY, WET)[number // 2]
        )
    newer = Keys(RING.with_key(b"n" * 32))
    await EventLog(store, keys=newer).record(kind="login", what="signed in")
    assert [chain for _, chain in chains(store)] == [DRY, DRY, WET, WET, DRY, WET, SITE]
    heads = store.read_now(heads_of)
    assert {head.key for head in heads.values()} == {newer.ring.newest}
    assert store.read_now(lambda c: prove(c, newer.ring, {})).broken is None


async def test_entries_of_one_transaction_are_noted_once(store: Database) -> None:
    entries = [new_entry(kind="estop", time=float(number), what="x", bus=DRY) for number in range(1, 4)]
    keys = passing_keys()
    assert store.write_now(lambda c: appending.append(c, entries, keys)) == [1, 2, 3]
    assert store.write_now(lambda c: appending.append(c, [], keys)) == []
    assert {chain: head.id for chain, head in store.read_now(heads_of).items()} == {SITE: 1, DRY: 3}


def before_chains(folder: Path) -> Path:
    """The steps up to the one before the chains."""
    folder.mkdir()
    for step in MIGRATIONS.glob("*.sql"):
        if step.name < "0140":
            shutil.copy(step, folder)
    return folder


def old_log(connection: StoreConnection, ring: KeyRing | None) -> Head:
    """Three entries as versions with one chain wrote them; without a ring, as those before the key."""
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
async def test_the_chain_of_an_old_store_goes_on_as_that_of_the_site(tmp_path: Path, is_sealed: bool) -> None:
    path = tmp_path / "lineside.db"
    with closing(Database(path, before_chains(tmp_path / "steps"))) as old:
        head = old.write_now(lambda c: old_log(c, RING if is_sealed else None))
        assert old.read_now(heads_of) == {SITE: head}
        ring = KeyRing(RING.keys, KeyOrigin() if is_sealed else KeyOrigin(head.id, head.hash))
        verdict = old.read_now(lambda c: prove(c, ring, {3: head}))
        assert (verdict.broken, verdict.entries) == (None, 3), "the command reads it as it is"
    with closing(Database(path)) as database:
        assert database.read_now(heads_of) == {SITE: head}
        log = EventLog(database, keys=Keys(ring))
        await log.record(kind="estop", what="new", bus=DRY)
        await log.record(kind="login", what="new")
        remarks: list[tuple[int, str | None]] = [] if is_sealed else [(4, SITE)]
        after = [(number, None) for number in (1, 2, 3)] + remarks
        first = len(after) + 1
        assert chains(database) == [*after, (first, DRY), (first + 1, SITE)]
        verdict = await log.proof.verify({3: head})
        assert (verdict.broken, verdict.unsealed) == (None, 0 if is_sealed else 3)
        assert [(chain.bus, chain.entries) for chain in verdict.chains] == [(None, first), (DRY, 1)]


async def test_the_anchor_of_an_old_store_is_continued(tmp_path: Path) -> None:
    path, steps = tmp_path / "lineside.db", before_chains(tmp_path / "steps")
    with closing(Database(path, steps)) as old:
        head = old.write_now(lambda c: old_log(c, RING))
    time = "2026-11-21T02:01:33Z"
    seal = RING.seal("anchor", "3", head.hash, time)
    line = f'{{"id":3,"hash":"{head.hash}","time":"{time}","key":"{RING.newest}","seal":"{seal}"}}\n'
    anchor = tmp_path / "anchor"
    anchor.write_text(line)
    with closing(Database(path)) as database:
        log = EventLog(database, keys=Keys(RING))
        await log.record(kind="estop", what="new", bus=DRY)
        anchoring = Anchoring(log, anchor)
        await anchoring.export()
        assert anchoring.status.altered is None
        anchors = read_anchors(anchor.read_bytes().splitlines(), RING)
        assert (sorted(anchors.heads), anchors.forged) == ([3, 4], None)
        assert (await log.proof.verify(anchors.heads)).anchored == 4


async def test_a_line_names_the_chains_that_changed_and_at_first_all(tmp_path: Path) -> None:
    anchor = tmp_path / "anchor"
    with closing(Database(tmp_path / "lineside.db")) as database:
        log = EventLog(database, keys=Keys(RING))
        anchoring = Anchoring(log, anchor)
        for bus in (DRY, WET, DRY):
            await log.record(kind="estop", what="e-stop", bus=bus)
            await anchoring.export()
        again = Anchoring(log, anchor)
        await log.record(kind="estop", what="e-stop", bus=DRY)
        await again.export()
        assert again.status.altered is None
        assert named_in(anchor) == [[1], [2], [3], [2, 4]], (
            "the beginning of a chain is one of the site's too"
        )
        heads = newest_anchor(anchor, RING)
        assert {chain: head.id for chain, head in heads.items()} == {SITE: 2, DRY: 4, WET: 2}


def named_in(anchor: Path) -> list[list[int]]:
    """The entries that each line names."""
    return [sorted(read_anchors([line], RING).heads) for line in anchor.read_bytes().splitlines()]


async def test_from_time_to_time_a_line_names_all_chains(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The start reads the end of a long file alone."""
    anchor = tmp_path / "anchor"
    monkeypatch.setattr("app.audit.proof.anchoring.FULL_EVERY_BYTES", 500)
    with closing(Database(tmp_path / "lineside.db")) as database:
        log = EventLog(database, keys=Keys(RING))
        await log.record(kind="estop", what="e-stop", bus=WET)
        anchoring = Anchoring(log, anchor)
        for _ in range(6):
            await log.record(kind="login", what="signed in")
            await anchoring.export()
    named = named_in(anchor)
    assert named[:2] == [[1, 2], [3]]
    assert any(1 in line for line in named[2:]), "the chain in which nothing follows is named again"


def test_a_chain_of_a_line_is_sealed_with_it() -> None:
    heads = {SITE: Head(1, "a" * 64), DRY: Head(2, "b" * 64, chain=DRY)}
    line = anchor_line(heads, 1.0, RING)
    assert read_anchors([line], RING).heads == {1: heads[SITE], 2: heads[DRY]}
    for forged in (line.replace(b"dry-end", b"wet-end"), line.replace(b"[1,", b"[3,")):
        assert read_anchors([forged], RING).forged == 1


def test_two_files_that_contradict_each_other_hold_no_log() -> None:
    first = Anchors({1: Head(1, "a" * 64, chain=DRY)})
    second = Anchors({1: Head(1, "b" * 64, chain=DRY), 2: Head(2, "c" * 64)})
    assert joined_heads(first, second) == {1: Head(1, "", chain=DRY), 2: Head(2, "c" * 64)}


def test_the_file_of_a_key_notes_where_every_chain_ended(tmp_path: Path) -> None:
    store, file = tmp_path / "lineside.db", tmp_path / "audit.key"
    store.touch()
    heads = {SITE: Head(7, "a" * 64), DRY: Head(9, "b" * 64, chain=DRY), WET: Head(8, "c" * 64, chain=WET)}
    made = open_keys([file], store, heads)
    made.rotate()
    read = open_keys([file], store, {}).ring.origin
    assert read == origin_of(heads)
    assert read.hashes == {7: "a" * 64, 8: "c" * 64, 9: "b" * 64}
