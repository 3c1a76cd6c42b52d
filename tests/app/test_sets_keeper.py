"""Sets at rest: immutable, golden, by schedule, and what drifts."""

from __future__ import annotations

import sqlite3
from datetime import UTC, datetime
from pathlib import Path

import pytest

from app.database import Database
from app.errors import Problem
from app.sets.keeper import SetKeeper, due_between
from app.sets.reading import ParameterReader
from app.sets.store import SetStore
from bus.contract import ParameterValue
from tests.app.played_desk import ANNA, Noted, PlayedDesk, a_bus, factory

NOON = datetime(2026, 11, 20, 12, 0, tzinfo=UTC)


class Scene:
    def __init__(self, folder: Path) -> None:
        self.live = a_bus()
        self.desk = PlayedDesk(self.live, {1: factory(), 2: factory()})
        self.events = Noted()
        self.database = Database(folder / "store.db")
        self.store = SetStore(self.database)
        reader = ParameterReader(self.live, self.desk)  # type: ignore[arg-type]
        self.keeper = SetKeeper(self.live, reader, self.store, self.events, lambda: NOON)  # type: ignore[arg-type]

    def tells(self, unit: int, number: int, raw: int) -> None:
        self.live.apply("dry-end", [ParameterValue(unit=unit, number=number, at=1.0, raw=raw)])


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    return Scene(tmp_path)


async def test_a_set_keeps_every_value_with_its_evidence(scene: Scene) -> None:
    kept = await scene.keeper.take(ANNA, "dry-end", [1, 2], "before the felt", "")
    again = await scene.store.load(kept.id)
    assert again is not None
    assert [unit.unit for unit in again.units] == [1, 2]
    row = again.units[0].rows[6]
    assert (row.raw, row.available, row.read_at, row.frame) == (0, True, 1.0, b"\x10")
    (summary,) = await scene.store.summaries("dry-end", 2)
    assert (summary.id, summary.units, summary.who, summary.origin) == (kept.id, (1, 2), "anna", "by hand")


async def test_nothing_is_kept_when_a_unit_does_not_answer(scene: Scene) -> None:
    scene.desk.silent_after = 0
    with pytest.raises(Problem):
        await scene.keeper.take(ANNA, "dry-end", [1], "", "")
    assert await scene.store.summaries() == []


@pytest.mark.parametrize("change", ["UPDATE parameter_set_row SET raw = 1", "DELETE FROM parameter_set_row"])
async def test_a_stored_set_does_not_change(scene: Scene, change: str) -> None:
    await scene.keeper.take(ANNA, "dry-end", [1], "", "")
    with pytest.raises(Exception, match="does not change"):
        await scene.database.write(lambda connection: connection.execute(change))


async def test_drift_is_what_departs_from_the_golden_set(scene: Scene) -> None:
    kept = await scene.keeper.take(ANNA, "dry-end", [1], "", "")
    assert scene.keeper.golden("dry-end", 1) is None
    await scene.keeper.mark_golden(ANNA, kept.id, 1)
    scene.tells(1, 6, 0)
    assert scene.keeper.drift("dry-end", 1) == []
    scene.tells(1, 6, 30)
    scene.tells(1, 20, 500)
    assert [row.number for row in scene.keeper.drift("dry-end", 1)] == [6]
    assert (scene.keeper.drifted("dry-end", 1), scene.keeper.drifted("dry-end", 2)) == (1, 0)
    scene.tells(1, 6, 0)
    assert scene.keeper.drifted("dry-end", 1) == 0
    with pytest.raises(Problem):
        await scene.keeper.mark_golden(ANNA, kept.id, 2)


async def test_before_the_first_write_of_a_day_what_is_known_is_kept_once(scene: Scene) -> None:
    await scene.keeper.keep_known(ANNA, "dry-end", 1)
    assert await scene.store.summaries() == []
    scene.tells(1, 6, 30)
    await scene.keeper.keep_known(ANNA, "dry-end", 1)
    await scene.keeper.keep_known(ANNA, "dry-end", 1)
    (summary,) = await scene.store.summaries("dry-end", 1)
    assert summary.origin == "before the first write of the day"
    assert scene.desk.asked == []


def test_a_daily_minute_is_due_once_also_over_midnight_and_for_two_buses() -> None:
    schedule = {"wet-end": 60, "dry-end": 60, "late": 1439}

    def at(day: int, hour: int, minute: int) -> datetime:
        return datetime(2026, 11, day, hour, minute, tzinfo=UTC)

    assert due_between(schedule, at(20, 0, 59), at(20, 1, 0)) == ["dry-end", "wet-end"]
    assert due_between(schedule, at(20, 1, 0), at(20, 1, 1)) == []
    assert due_between(schedule, at(20, 23, 58), at(21, 0, 1)) == ["late"]
    assert due_between(schedule, at(20, 23, 58), at(21, 1, 0)) == ["late", "dry-end", "wet-end"]


async def test_the_schedule_is_kept_and_ended(scene: Scene) -> None:
    await scene.keeper.set_schedule(ANNA, "dry-end", 125)
    assert await scene.store.schedule() == {"dry-end": 125}
    assert "02:05" in scene.events.events[-1]["what"]
    await scene.keeper.set_schedule(ANNA, "dry-end", None)
    assert await scene.store.schedule() == {}
    with pytest.raises(sqlite3.IntegrityError):
        await scene.store.set_schedule("dry-end", 1440)
