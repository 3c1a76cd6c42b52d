"""Automatic sets: every day at a minute, and before the first write of a day."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from app.core.web.admission.access import Person, Role
from app.engineering.sets.saving import REPORT_AFTER, FirstWrites, SetSchedule, due_between
from app.errors import ConstraintError, Problem
from bus.catalogue.parameters import PARAMETERS
from bus.contract import UnitLink, UnitLinkState
from tests.app.played_commands import ANNA, SetScene

NOON = datetime(2026, 3, 4, 12, tzinfo=UTC)
MIDNIGHT = NOON - timedelta(hours=12)


class Scene(SetScene):
    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.now = NOON
        self.schedule = SetSchedule(self.live.buses["dry-end"], self.keeper, self.events, lambda: self.now)  # type: ignore[arg-type]
        self.first = FirstWrites(self.live.buses["dry-end"], self.commands, self.keeper, lambda: self.now)

    def link(self, unit: int, state: UnitLinkState) -> None:
        self.live.buses["dry-end"].apply([UnitLink(unit=unit, at=1.0, link=state)])

    async def kept(self, unit: int) -> list[str]:
        return [summary.origin for summary in await self.store.summaries("dry-end", unit)]


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scene]:
    made = Scene(tmp_path)
    monkeypatch.setattr("app.engineering.sets.saving.unix_now", lambda: made.now.timestamp())
    yield made
    made.database.close()


BEFORE, AFTER = "before the first write of the day", "after the first write of the day"


async def test_what_could_not_be_kept_for_one_person_is_kept_for_the_next(scene: Scene) -> None:
    scene.report(1, *PARAMETERS)
    scene.rights.withdrawn["anna"] = "rights withdrawn"
    with pytest.raises(Problem):
        await scene.first.before(ANNA, [1], parameters=True)
    await scene.first.before(ANNA, [1], parameters=False)
    await scene.first.background.settled()
    assert await scene.kept(1) == []
    await scene.first.before(Person("ben", Role.ENGINEER, "session"), [1], parameters=True)
    assert await scene.kept(1) == [BEFORE]


async def test_before_the_first_parameter_write_known_values_are_stored_once_and_the_rest_follows(
    scene: Scene,
) -> None:
    await scene.first.before(ANNA, [1], parameters=True)
    assert await scene.kept(1) == []
    scene.report(1, 6)
    await scene.first.before(ANNA, [1], parameters=True)
    assert scene.commands.sent == []
    summary = (await scene.store.summaries("dry-end", 1))[-1]
    assert summary.origin == BEFORE
    await scene.first.background.settled()
    await scene.first.before(ANNA, [1], parameters=True)
    assert await scene.kept(1) == [AFTER, BEFORE]


async def test_a_setpoint_waits_for_nothing_and_saves_every_completely_known_unit(scene: Scene) -> None:
    scene.report(1, *range(1, 41))
    scene.report(2, 6)
    await scene.first.before(ANNA, [1, 2], parameters=False)
    scene.report(1, 6)
    await scene.first.background.settled()
    assert (await scene.kept(1), await scene.kept(2)) == ([BEFORE], [])
    assert scene.commands.sent == []
    await scene.first.before(ANNA, [1, 2], parameters=False)
    await scene.first.background.settled()
    assert await scene.kept(1) == [BEFORE]


async def test_a_new_day_saves_again_and_one_set_a_day_is_enough(scene: Scene) -> None:
    await scene.keeper.read_and_save(ANNA, [1])
    scene.report(1, *range(1, 41))
    await scene.first.before(ANNA, [1], parameters=True)
    assert await scene.kept(1) == ["by hand"]
    scene.now += timedelta(days=1)
    await scene.first.before(ANNA, [1], parameters=True)
    assert await scene.kept(1) == [BEFORE, "by hand"]


async def test_due_units_are_saved_as_one_set_and_once(scene: Scene) -> None:
    await scene.schedule.set(ANNA, 0)
    for unit in (1, 2):
        scene.link(unit, "online")
    await scene.schedule.save_due(MIDNIGHT, NOON)
    assert await scene.kept(1) == []
    before = MIDNIGHT - timedelta(minutes=1)
    await scene.schedule.save_due(before, NOON)
    await scene.schedule.save_due(NOON, NOON)
    (summary,) = await scene.store.summaries("dry-end")
    assert (summary.origin, summary.units) == ("on schedule", (1, 2))
    await scene.schedule.save_due(before, NOON)
    assert await scene.kept(1) == ["on schedule"]


async def test_a_unit_without_response_at_its_minute_is_reported_once_and_saved_when_it_responds(
    scene: Scene,
) -> None:
    await scene.schedule.set(ANNA, 0)
    scene.link(1, "online")
    scene.link(2, "offline")
    await scene.schedule.save_due(MIDNIGHT - timedelta(minutes=1), NOON)
    assert (await scene.kept(1), await scene.kept(2)) == (["on schedule"], [])
    assert scene.schedule.overdue() == {}
    for _ in range(2):
        await scene.schedule.save_due(NOON, NOON + REPORT_AFTER)
    missed = [event for event in scene.events.events if "not saved on schedule" in event["what"]]
    assert [(event["unit"], event["message"]) for event in missed] == [(2, ("the unit does not respond"))]
    assert list(scene.schedule.overdue()) == [2]
    scene.link(2, "online")
    await scene.schedule.save_due(NOON, NOON + REPORT_AFTER)
    assert (await scene.kept(2), scene.schedule.overdue()) == (["on schedule"], {})


async def test_a_unit_that_stops_responding_while_it_is_read_stays_overdue(scene: Scene) -> None:
    await scene.schedule.set(ANNA, 0)
    scene.link(1, "online")
    scene.commands.timeout_after = 0
    await scene.schedule.save_due(MIDNIGHT - timedelta(minutes=1), NOON)
    assert str(scene.schedule.overdue()[1].why) == "no response"
    scene.commands.timeout_after = None
    await scene.schedule.save_due(NOON, NOON)
    assert await scene.kept(1) == ["on schedule"]


def test_a_daily_minute_is_due_once_also_over_midnight() -> None:
    def at(day: int, hour: int, minute: int) -> datetime:
        return datetime(2026, 11, day, hour, minute, tzinfo=UTC)

    assert due_between(60, at(20, 0, 59), at(20, 1, 0)) == at(20, 1, 0)
    assert due_between(60, at(20, 1, 0), at(20, 1, 1)) is None
    assert due_between(1439, at(20, 23, 58), at(21, 0, 1)) == at(20, 23, 59)
    assert due_between(60, at(20, 23, 58), at(21, 1, 0)) == at(21, 1, 0)
    assert due_between(60, at(20, 0, 58), at(21, 1, 0)) == at(21, 1, 0), "the last of two"


@pytest.mark.parametrize("role", [Role.VIEWER, Role.OPERATOR, Role.WORKER])
async def test_a_caller_without_a_route_needs_the_role_too(scene: Scene, role: Role) -> None:
    await scene.schedule.set(ANNA, 125)
    for minute in (0, None):
        with pytest.raises(Problem, match="role engineer"):
            await scene.schedule.set(Person("ben", role, "session"), minute)
    assert await scene.store.schedule() == {"dry-end": 125}


async def test_the_schedule_is_kept_and_ended(scene: Scene) -> None:
    await scene.schedule.set(ANNA, 125)
    assert await scene.store.schedule() == {"dry-end": 125}
    assert "02:05" in scene.events.events[-1]["what"]
    await scene.schedule.set(ANNA, None)
    assert await scene.store.schedule() == {}
    with pytest.raises(ConstraintError):
        await scene.store.set_schedule("dry-end", 1440)
