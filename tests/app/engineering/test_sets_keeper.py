"""Sets at rest: immutable, golden, and what drifts."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest

from app.core.web.admission.access import Person, Role
from app.engineering.sets.saving import SetReadings
from app.errors import Problem, StoreError
from bus.messages import Message
from tests.app.played_commands import ANNA, SetScene
from tests.app.screens import translator

NOON = datetime(2026, 11, 20, 12, 0, tzinfo=UTC)


class Scene(SetScene):
    def line_reports(self, unit: int) -> str:
        return self.drift.summary(unit, translator(), NOON.timestamp()).words


@pytest.fixture
def scene(tmp_path: Path) -> Iterator[Scene]:
    made = Scene(tmp_path)
    yield made
    made.database.close()


async def test_a_set_keeps_every_value_with_its_evidence(scene: Scene) -> None:
    kept = await scene.keeper.read_and_save(ANNA, [1, 2], "before the felt", "")
    again = await scene.store.load(kept.id)
    assert again is not None
    assert [unit.unit for unit in again.units] == [1, 2]
    row = again.units[0].rows[6]
    assert (row.raw, row.available, row.read_at, row.frame) == (0, True, 1.0, b"\x10")
    (summary,) = await scene.store.summaries("dry-end", 2)
    assert (summary.id, summary.units, summary.who, summary.origin) == (kept.id, (1, 2), "anna", "by hand")


async def test_the_list_goes_on_before_the_oldest_that_was_shown(scene: Scene) -> None:
    ids = [(await scene.keeper.read_and_save(ANNA, [1])).id for _ in range(3)]
    newest = await scene.store.summaries(limit=2)
    assert [summary.id for summary in newest] == ids[:0:-1]
    older = await scene.store.summaries(before=newest[-1].id, limit=2)
    assert [summary.id for summary in older] == ids[:1]


async def test_nothing_is_saved_when_a_unit_does_not_respond(scene: Scene) -> None:
    scene.commands.timeout_after = 0
    with pytest.raises(Problem):
        await scene.keeper.read_and_save(ANNA, [1])
    assert await scene.store.summaries() == []


@pytest.mark.parametrize("failing", ["saving", "reading"])
async def test_a_reading_that_cannot_be_stored_ends_as_failed_with_its_reason(
    scene: Scene, monkeypatch: pytest.MonkeyPatch, failing: str
) -> None:
    async def full(*_: object, **__: object) -> None:
        raise StoreError(Message.of("system_error", error="the disk is full"))

    if failing == "saving":
        monkeypatch.setattr(scene.store, "save", full)
    else:
        monkeypatch.setattr(scene.commands, "send", full)
    takings = SetReadings()
    taking = takings.begin(ANNA, scene.keeper, [1, 2], "", "")
    await takings.background.settled()
    assert (taking.state, taking.set_id) == ("failed", None)
    reasons = [taking.cause] if failing == "saving" else list(taking.missing.values())
    assert {str(reason) for reason in reasons} == {"the disk is full"}


async def test_golden_sets_of_all_units_are_those_of_the_units_that_responded(scene: Scene) -> None:
    scene.commands.dead.add(2)
    takings = SetReadings()
    taking = takings.begin(ANNA, scene.keeper, [1, 2], "", "", golden=True)
    assert taking.values_read(scene.keeper) == {1: 0, 2: 0}
    scene.report(1, 6, raw=0, at=taking.began)
    scene.report(1, 7, raw=0, at=taking.began - 1)
    assert taking.values_read(scene.keeper) == {1: 1, 2: 0}
    await takings.background.settled()
    assert (taking.state, list(taking.missing)) == ("kept", [2])
    assert taking.values_read(scene.keeper) == {1: 40, 2: 40}
    assert [summary.golden_for for summary in await scene.store.summaries()] == [(1,)]


async def test_a_set_that_was_saved_and_not_marked_keeps_its_number(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def full(*_: object) -> None:
        raise StoreError(Message.of("system_error", error="the disk is full"))

    monkeypatch.setattr(scene.store, "mark_golden", full)
    takings = SetReadings()
    taking = takings.begin(ANNA, scene.keeper, [1], "", "", golden=True)
    await takings.background.settled()
    assert (taking.state, taking.set_id, str(taking.cause)) == ("failed", 1, "the disk is full")


@pytest.mark.parametrize("role", [Role.VIEWER, Role.OPERATOR, Role.WORKER])
async def test_a_caller_without_a_route_needs_the_role_too(scene: Scene, role: Role) -> None:
    kept, person, takings = (
        await scene.keeper.read_and_save(ANNA, [1]),
        Person("ben", role, "session"),
        SetReadings(),
    )
    read = len(scene.commands.sent)
    with pytest.raises(Problem, match="role engineer"):
        await scene.keeper.read_and_save(person, [1])
    with pytest.raises(Problem, match="role engineer"):
        await scene.keeper.mark_golden(person, kept, [1])
    with pytest.raises(Problem, match="role engineer"):
        takings.begin(person, scene.keeper, [1], "", "")
    assert len(scene.commands.sent) == read
    assert [summary.golden_for for summary in await scene.store.summaries()] == [()]


@pytest.mark.parametrize("change", ["UPDATE parameter_set_row SET raw = 1", "DELETE FROM parameter_set_row"])
async def test_a_stored_set_does_not_change(scene: Scene, change: str) -> None:
    await scene.keeper.read_and_save(ANNA, [1])
    with pytest.raises(Exception, match="does not change"):
        await scene.database.write(lambda connection: connection.execute(change))


async def test_drift_is_what_departs_from_the_golden_set(scene: Scene) -> None:
    kept = await scene.keeper.read_and_save(ANNA, [1])
    drift = scene.drift
    assert not drift.has_golden(1)
    await scene.keeper.mark_golden(ANNA, kept, [1])
    scene.report(1, 6, raw=0)
    assert drift.differing(1) == []
    assert drift.unread(1) == 39
    scene.report(1, 6)
    scene.report(1, 20, raw=500)
    assert [one.row.number for one in drift.differing(1)] == [6]
    assert drift.differing(2) == []
    assert scene.line_reports(1) == "Acceleration Ramp Rate (parameter 6) differs from the golden set"
    scene.report(1, 6, raw=0)
    assert (drift.differing(1), scene.line_reports(1)) == ([], "")
    with pytest.raises(Problem):
        await scene.keeper.mark_golden(ANNA, kept, [2])
