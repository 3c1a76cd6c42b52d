"""A restore as it runs: each row with its fate, stopped by anything, finished by running it again."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

from app.database import Database
from app.errors import Problem
from app.sets.model import Row, UnitRows
from app.sets.reading import ParameterReader
from app.sets.restore import RestoreDesk
from app.sets.restore_record import Restore
from app.sets.restore_store import RestoreStore
from tests.app.played_desk import ANNA, Noted, PlayedDesk, a_bus, factory

WANTED = {6: 50, 7: 60, 9: 1234, 12: 7}


def rows(values: dict[int, int]) -> UnitRows:
    return UnitRows(2, "Nip", {number: Row(number, raw) for number, raw in values.items()})


class Scene:
    def __init__(self, database: Database, **desk: object) -> None:
        live = a_bus()
        self.desk = PlayedDesk(live, {1: factory(), 2: factory()}, **desk)  # type: ignore[arg-type]
        self.events = Noted()
        reader = ParameterReader(live, self.desk)  # type: ignore[arg-type]
        self.reader, self.store = reader, RestoreStore(database)
        self.restores = self.server()

    def server(self) -> RestoreDesk:
        """The desk of a server that has just been started."""
        return RestoreDesk(self.reader, self.desk, self.events, self.store)  # type: ignore[arg-type]

    async def run(self, wanted: dict[int, int] = WANTED) -> Restore:
        restore = await self.restores.plan(ANNA, "dry-end", 2, rows(wanted), running=False)
        await self.finish(restore)
        return restore

    async def finish(self, restore: Restore) -> None:
        self.events.noted.clear()
        self.restores.start(ANNA, restore)
        await asyncio.wait_for(self.events.noted.wait(), 10)


SetsScene = Callable[..., Scene]


@pytest.fixture
def a_scene(tmp_path: Path) -> Iterator[SetsScene]:
    database = Database(tmp_path / "lineside.db")
    yield partial(Scene, database)
    database.close()


async def test_nothing_is_written_before_the_start(a_scene: SetsScene) -> None:
    scene = a_scene()
    restore = await scene.restores.plan(ANNA, "dry-end", 2, rows(WANTED), running=False)
    assert scene.desk.written == []
    assert (restore.state, restore.done) == ("planned", 0)
    assert [row.write.number for row in restore.rows] == [6, 7, 9, 12]


async def test_only_what_differs_is_written_and_a_full_read_proves_it(a_scene: SetsScene) -> None:
    scene = a_scene()
    scene.desk.memory[2][6] = 50
    restore = await scene.run()
    assert scene.desk.written == [(2, 7, 60), (2, 9, 1234), (2, 12, 7)]
    assert restore.state == "equal"
    assert restore.remaining == []
    assert {row.outcome for row in restore.rows} == {"verified"}
    assert scene.events.events[-1]["outcome"] == "equal"


async def test_one_refused_row_does_not_cost_the_others(a_scene: SetsScene) -> None:
    scene = a_scene(refuses={7: 0x83})
    restore = await scene.run()
    fates = {row.write.number: row.outcome for row in restore.rows}
    assert fates == {6: "verified", 7: "refused", 9: "verified", 12: "verified"}
    assert "illegal parameter value" in restore.rows[1].message
    assert restore.state == "different"
    assert restore.remaining is not None
    assert [row.number for row in restore.remaining] == [7]


async def test_silence_stops_it_and_running_it_again_finishes_the_rest(a_scene: SetsScene) -> None:
    scene = a_scene(silent_after=2)
    restore = await scene.run()
    assert restore.state == "stopped"
    assert "no answer" in restore.cause
    assert [row.outcome for row in restore.rows] == ["verified", "verified", "unverified", None]
    scene.desk.silent_after = None
    again = await scene.run()
    assert [row.write.number for row in again.rows] == [9, 12]
    assert again.state == "equal"


async def test_left_off_it_says_which_rows_are_done(a_scene: SetsScene) -> None:
    scene = a_scene()
    restore = await scene.restores.plan(ANNA, "dry-end", 2, rows(WANTED), running=False)
    restore.cancel()
    await scene.finish(restore)
    assert restore.state == "stopped"
    assert scene.desk.written == []


async def test_it_starts_once_and_one_at_a_time_for_a_unit(a_scene: SetsScene) -> None:
    scene = a_scene()
    one = await scene.restores.plan(ANNA, "dry-end", 2, rows(WANTED), running=False)
    other = await scene.restores.plan(ANNA, "dry-end", 2, rows(WANTED), running=False)
    scene.restores.start(ANNA, one)
    for restore in (one, other):
        with pytest.raises(Problem):
            scene.restores.start(ANNA, restore)
    await asyncio.wait_for(scene.events.noted.wait(), 10)
    assert one.state == "equal"
    with pytest.raises(Problem):
        scene.restores.start(ANNA, one)


async def test_a_unit_with_the_first_twenty_parameters_only(a_scene: SetsScene) -> None:
    scene = a_scene(lacks=frozenset(range(21, 41)))
    restore = await scene.run(WANTED | {29: 5, 39: 3})
    assert {left.number: left.reason for left in restore.left_out}[29] == "this unit does not have it"
    assert restore.state == "equal"


async def test_a_unit_that_does_not_answer_has_no_plan(a_scene: SetsScene) -> None:
    scene = a_scene(silent_after=0)
    with pytest.raises(Problem) as refused:
        await scene.restores.plan(ANNA, "dry-end", 2, rows(WANTED), running=False)
    assert refused.value.status == 504
    assert scene.desk.written == []


async def test_a_killed_server_left_the_exact_list_of_what_was_done(a_scene: SetsScene) -> None:
    scene = a_scene(hangs_after=2)
    killed = await scene.restores.plan(ANNA, "dry-end", 2, rows(WANTED), running=False)
    scene.restores.start(ANNA, killed)
    await asyncio.wait_for(scene.desk.hanging.wait(), 10)

    after = scene.server()
    await after.load()
    found = await after.find(killed.id)
    assert found is not None
    assert (found.state, found.who) == ("stopped", "anna")
    assert [row.outcome for row in found.rows] == ["verified", "verified", "unverified", None]
    assert scene.events.events[-1]["outcome"] == "stopped"
    assert scene.events.events[-1]["message"].endswith("done: #6, #7; in doubt: #9; not written: #12")
    await scene.restores.close()

    scene.desk.hangs_after, scene.restores = None, after
    again = await scene.run()
    assert [row.write.number for row in again.rows] == [9, 12]
    assert [one.id for one in await after.of_unit("dry-end", 2)] == [again.id, killed.id]
    assert (await scene.server().find(again.id)) is not None


async def test_what_a_restore_found_is_the_same_after_the_next_start(a_scene: SetsScene) -> None:
    scene = a_scene(refuses={7: 0x83})
    restore = await scene.run(WANTED | {18: 48})
    kept = await scene.server().find(restore.id)
    assert kept is not None
    assert (kept.state, kept.rows, kept.left_out) == (restore.state, restore.rows, restore.left_out)
    assert kept.remaining is not None
    assert [row.number for row in kept.remaining] == [7]


async def test_a_unit_in_local_is_said_beforehand_and_is_not_called_equal(a_scene: SetsScene) -> None:
    scene = a_scene()
    scene.desk.memory[2][19] = 0
    restore = await scene.run()
    assert scene.desk.written == []
    assert {left.number for left in restore.left_out if left.later} == set(WANTED)
    assert restore.state == "different"
