"""An attacker who can write the store, but cannot read the key, takes the chains of the audit log apart: what
is removed, moved from one chain to another or put back is named with its bus.
"""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from app.audit.events.store import heads_of
from app.audit.log import EventLog
from app.audit.proof.anchoring import Anchoring
from app.audit.proof.chain import END_ALTERED, ROTATED, SITE, sealed_entry, sealed_head
from app.audit.proof.keyring import KeyRing
from app.audit.proof.keys import open_keys
from app.audit.proof.walk import MAX_CHAINS
from app.cli import cli
from app.database import Database
from tests.attacks.test_audit_log import WITHOUT_ANCHOR, Plant

Row = dict[str, Any]
DRY, WET = "dry-end", "wet-end"


class Site(Plant):
    """A plant with two buses: entries of one, the other and the site by turns, ids 1 to 9. Entry 1 begins the
    chain of the first, 2 that of the second."""

    def work(self, entries: int = 9, buses: Iterable[str | None] = (DRY, WET, None)) -> None:
        asyncio.run(self._record(entries, list(buses)))

    async def _record(self, entries: int, buses: list[str | None]) -> None:
        database = Database(self.store)
        try:
            keys = open_keys([self.key], self.store, await database.read(heads_of))
            log = EventLog(database, keys=keys)
            for number in range(entries):
                await log.record(kind="estop", what=f"e-stop {number}", bus=buses[number % len(buses)])
            await Anchoring(log, self.anchor).export()
        finally:
            database.close()

    def rows(self, query: str) -> list[Row]:
        with closing(sqlite3.connect(self.store)) as connection:
            connection.row_factory = sqlite3.Row
            return [dict(row) for row in connection.execute(query)]

    def put(self, table: str, *rows: Row) -> None:
        """Put rows in the place of those with their key."""
        self.attack()
        with closing(sqlite3.connect(self.store)) as connection:
            for row in rows:
                marks = ", ".join("?" * len(row))
                columns = ", ".join(row)
                connection.execute(
                    f"INSERT OR REPLACE INTO {table} ({columns}) VALUES ({marks})", [*row.values()]
                )
            connection.commit()

    def reseal(
        self, bus: str, change: Callable[[Row], Row], *, ring: KeyRing, since: int, until: int
    ) -> None:
        """Rewrite the entries of a chain with a key that the attacker knows, and its end."""
        log = {row["id"]: row for row in self.rows(f"SELECT * FROM events WHERE chain = '{bus}'")}
        previous = log[since]["previous"]
        for number in (number for number in sorted(log) if since <= number <= until):
            row = sealed_entry(previous, change(log[number]), ring)
            previous = row["hash"]
            self.put("events", row)
        if until == max(log):
            head = sealed_head(row, ring, bus)
            end = {"chain": bus, "id": head.id, "hash": head.hash, "key": head.key, "seal": head.seal}
            self.put("events_head", end)

    def ring(self) -> KeyRing:
        return open_keys([self.key], self.store, {}).ring

    def faults(self) -> str:
        """What `audit verify` states without any anchor."""
        self.key_anchor.unlink(missing_ok=True)
        code, printed = self.verify(*WITHOUT_ANCHOR)
        assert code == 1, printed
        return printed.replace("\n", " ")


@pytest.fixture
def plant(tmp_path: Path) -> Site:
    made = Site(tmp_path)
    made.work()
    code, printed = made.verify()
    assert (code, f"chains: the site, {DRY}, {WET}" in printed) == (0, True), printed
    return made


def of(bus: str) -> str:
    return f"the audit log of {bus} is broken at entry "


def nothing(row: Row) -> Row:
    return row | {"what": "nothing happened"}


@pytest.mark.parametrize("bus", [DRY, WET])
def test_a_complete_chain_is_removed(plant: Site, bus: str) -> None:
    """The chain of the site is linked to its first entry."""
    plant.attack(
        f"DELETE FROM events WHERE chain = '{bus}'", f"DELETE FROM events_head WHERE chain = '{bus}'"
    )
    first = 1 if bus == DRY else 2
    code, printed = plant.verify()
    assert code == 1
    assert of(bus) + str(first) in printed, "the anchor names the bus"
    assert f"the audit log is broken at entry {first}: entry {first} is missing" in plant.faults()


def test_the_chain_that_came_last_is_removed(plant: Site) -> None:
    """No entry follows it, so that no number is missing in between."""
    plant.work(3, ["new"])
    plant.attack("DELETE FROM events WHERE chain = 'new'", "DELETE FROM events_head WHERE chain = 'new'")
    assert "broken at entry 10: the log ends at entry 9, but 10 were written" in plant.faults()


def test_all_but_the_first_entry_of_the_chain_that_came_last_is_removed(plant: Site) -> None:
    """The end of the site's chain, which is that first entry, is put in the place of the removed one."""
    plant.work(3, ["new"])
    [end] = plant.rows("SELECT * FROM events_head WHERE chain = ''")
    assert end["id"] == 10
    plant.attack("DELETE FROM events WHERE id > 10", "DELETE FROM events_head WHERE chain = 'new'")
    assert of("new") + "10: entry 10 is not the one that was noted as the newest" in plant.faults()
    plant.put("events_head", end | {"chain": "new"})
    assert of("new") + "10: the log ends at entry 10, but what notes that end is not sealed" in plant.faults()


@pytest.mark.parametrize(("number", "to"), [(4, WET), (4, SITE), (4, None), (4, "new"), (6, DRY), (1, WET)])
def test_an_entry_is_moved_to_another_chain(plant: Site, number: int, to: str | None) -> None:
    [row] = plant.rows(f"SELECT * FROM events WHERE id = {number}")
    plant.put("events", row | {"chain": to, "bus": to or None})
    assert f"entry {number} " in plant.faults()


@pytest.mark.parametrize(("number", "to"), [(4, WET), (6, DRY), (9, WET), (8, SITE)])
def test_an_entry_is_moved_and_every_hash_made_to_fit(plant: Site, number: int, to: str) -> None:
    def moved(rows: list[Row]) -> list[Row]:
        rows[number - 1] |= {"chain": to, "bus": to or None}
        return rows

    plant.rebuild(moved)
    assert f"the seal of entry {number} does not hold" in plant.faults()


def test_entries_of_two_chains_change_places(plant: Site) -> None:
    four, five = plant.rows("SELECT * FROM events WHERE id IN (4, 5) ORDER BY id")
    plant.put("events", four | {"id": 5}, five | {"id": 4})
    faults = plant.faults()
    assert of(WET) + "4: entry 4 was changed" in faults
    assert of(DRY) + "5: entry 5 was changed" in faults


def test_entries_change_chains_and_every_hash_is_made_to_fit(plant: Site) -> None:
    def swapped(rows: list[Row]) -> list[Row]:
        rows[3], rows[4] = rows[4], rows[3]
        return rows

    plant.rebuild(swapped)
    faults = plant.faults()
    assert of(WET) + "4: the seal of entry 4 does not hold" in faults
    assert of(DRY) + "5: the seal of entry 5 does not hold" in faults


def test_the_ends_of_two_chains_are_exchanged(plant: Site) -> None:
    plant.attack()
    dry, wet = plant.rows("SELECT * FROM events_head WHERE chain <> '' ORDER BY chain")
    plant.put("events_head", dry | {"chain": WET}, wet | {"chain": DRY})
    faults = plant.faults()
    assert of(DRY) in faults
    assert of(WET) in faults
    plant.work(2, [DRY, WET])
    assert of(DRY) in plant.faults(), "the server went on from there"


def test_the_end_of_one_chain_is_put_back_while_the_others_go_on(plant: Site) -> None:
    """With an earlier copy of its end, which is sealed: only the numbers that are missing show it."""
    [earlier] = plant.rows(f"SELECT * FROM events_head WHERE chain = '{DRY}'")
    plant.work()
    plant.attack(f"DELETE FROM events WHERE chain = '{DRY}' AND id > 9")
    plant.put("events_head", earlier)
    assert of(DRY) + "10: entry 10 is missing; after 9 comes 11" in plant.verify()[1].replace("\n", " ")
    assert "the audit log is broken at entry 10: entry 10 is missing; after 9 comes 11" in plant.faults()


def test_the_end_of_a_chain_is_removed_and_the_server_goes_on(plant: Site) -> None:
    """It begins the chain a second time, which the walk does not take for its beginning."""
    plant.attack(f"DELETE FROM events_head WHERE chain = '{DRY}'")
    assert of(DRY) + "7: entry 7 is not the one that was noted as the newest" in plant.faults()
    plant.work(3)
    assert of(DRY) + "10: entry 10 does not continue the one before it" in plant.faults()


@pytest.mark.parametrize("bus", [DRY, WET, None])
def test_an_entry_is_added_behind_the_end_and_the_server_goes_on(plant: Site, bus: str | None) -> None:
    [row] = plant.rows("SELECT * FROM events WHERE id = 7")
    plant.put("events", row | {"id": 10})
    assert of(DRY) in plant.faults()
    plant.work(1, [bus])
    [noted] = plant.rows(f"SELECT chain FROM events WHERE what = '{END_ALTERED}'")
    assert noted["chain"] == (bus or SITE)
    plant.attack("DELETE FROM events WHERE id = 10")
    assert "entry 10 is missing" in plant.faults()


def test_an_entry_before_the_first_takes_the_place_of_the_log(plant: Site) -> None:
    """Numbers begin at 1 again, and the anchor misses what was there."""
    [row] = plant.rows("SELECT * FROM events WHERE id = 3")
    plant.attack("DELETE FROM events", "DELETE FROM events_head")
    plant.put("events", row | {"id": -5})
    plant.work(2)
    assert [row["id"] for row in plant.rows("SELECT id FROM events ORDER BY id")] == [-5, 1, 2, 3]
    assert "the log ends at entry 3, but the anchor names entry 8" in plant.verify()[1].replace("\n", " ")
    assert "entry 1 is missing; after 0 comes -5" in plant.faults()


def test_every_broken_chain_is_named_and_the_others_are_not(plant: Site) -> None:
    plant.attack("UPDATE events SET what = 'nothing happened' WHERE id IN (4, 6)")
    faults = plant.faults()
    assert of(DRY) + "4: " in faults
    assert "the audit log is broken at entry 6: " in faults
    assert WET not in faults


def test_invented_chains_and_gaps_without_number_delay_no_proof(plant: Site) -> None:
    [row] = plant.rows("SELECT * FROM events WHERE id = 8")
    plant.put("events", *(row | {"id": 20 + 2 * n, "chain": f"new {n}"} for n in range(2 * MAX_CHAINS)))
    assert plant.faults().count("the audit log of ") <= MAX_CHAINS


def test_an_older_key_rewrites_no_chain_in_which_nothing_followed(plant: Site) -> None:
    """The first use of a newer key seals the end of every chain with it."""
    older = plant.ring()
    rotated = CliRunner().invoke(cli, ["audit", "rotate-key", "--config", str(plant.config)])
    assert rotated.exit_code == 0, rotated.output
    assert plant.verify()[0] == 0
    newest = plant.ring().newest
    assert {row["key"] for row in plant.rows("SELECT key FROM events_head")} == {newest}
    assert len(plant.rows(f"SELECT id FROM events WHERE what = '{ROTATED}'")) == 3
    plant.reseal(WET, nothing, ring=older, since=5, until=8)
    assert of(WET) in plant.faults()


def test_an_older_key_removes_no_end_that_the_newer_one_sealed(plant: Site) -> None:
    older = plant.ring()
    CliRunner().invoke(cli, ["audit", "rotate-key", "--config", str(plant.config)])
    numbers = [row["id"] for row in plant.rows(f"SELECT id FROM events WHERE what = '{ROTATED}'")]
    plant.attack(f"DELETE FROM events WHERE id >= {min(numbers)}")
    for chain in (DRY, WET, SITE):
        [row] = plant.rows(f"SELECT * FROM events WHERE chain = '{chain}' ORDER BY id DESC LIMIT 1")
        head = sealed_head(row, older, chain)
        plant.put(
            "events_head", dict(zip(("id", "hash", "key", "seal", "chain"), vars(head).values(), strict=True))
        )
    faults = plant.faults()
    assert faults.count("no entry is sealed with the newest key") == 3


def test_a_chain_from_before_a_new_key_is_held_to_what_it_was(plant: Site) -> None:
    """The key is lost: the file of the new one notes where each chain ended."""
    plant.key.unlink()
    for anchor in (plant.anchor, plant.key_anchor):
        anchor.unlink()
    plant.work(1, [None])
    assert plant.verify()[0] == 0
    stranger = KeyRing((b"s" * 32,))
    plant.reseal(WET, nothing, ring=stranger, since=8, until=8)
    assert of(WET) + "8: entry 8 is not the one that was there when the key was made" in plant.faults()


def test_with_the_key_a_chain_is_rewritten_up_to_what_an_anchor_names(plant: Site) -> None:
    plant.reseal(WET, nothing, ring=plant.ring(), since=8, until=8)
    assert of(WET) + "8: entry 8 is not the one that the anchor names" in plant.verify()[1].replace("\n", " ")
    plant.key_anchor.unlink()
    assert plant.verify(*WITHOUT_ANCHOR)[0] == 0, "no seal shows it"


def test_the_start_compares_every_chain_with_its_anchors(plant: Site) -> None:
    async def altered() -> str:
        database = Database(plant.store)
        try:
            log = EventLog(database, keys=open_keys([plant.key], plant.store, {}))
            anchoring = Anchoring(log, plant.anchor)
            await anchoring.export()
            return str(anchoring.status.altered)
        finally:
            database.close()

    assert asyncio.run(altered()) == "None"
    plant.reseal(WET, nothing, ring=plant.ring(), since=8, until=8)
    assert asyncio.run(altered()) == "entry 8 is not the one that the anchor names"


def test_a_restored_backup_names_where_every_chain_ended(plant: Site, tmp_path: Path) -> None:
    for words in (
        ["backup-store", str(tmp_path / "one.tar")],
        ["restore-store", str(tmp_path / "one.tar"), "--yes"],
    ):
        plant.anchor.unlink(missing_ok=True)
        done = CliRunner().invoke(cli, [*words, "--config", str(plant.config)])
        assert done.exit_code == 0, done.output
    [event] = plant.rows("SELECT message FROM events WHERE what = 'the stores were restored from a backup'")
    assert "the audit log that was replaced ended at entry 9, " in event["message"]
    assert f"its chain of {DRY} at entry 7, " in event["message"]
    assert f"its chain of {WET} at entry 8, " in event["message"]
    plant.work()
    assert plant.verify()[0] == 0


def test_a_seal_of_an_end_is_of_its_chain_alone() -> None:
    ring = KeyRing((b"k" * 32,))
    seals = {sealed_head({"id": 1, "hash": "a" * 64}, ring, chain).seal for chain in (SITE, DRY, WET)}
    assert len(seals) == 3
    assert ring.seal("head", "1", "a" * 64) in seals, "as versions with one chain sealed it"
