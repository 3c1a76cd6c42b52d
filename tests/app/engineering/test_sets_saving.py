"""Saving sets, by hand, daily and before the first write of a day, and batch edits."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
import pytest

from app.core.web.access import Person, Role
from app.engineering.sets.batch import BatchRow, refuse_moved, rows_of_batch, write_batch
from app.engineering.sets.saving import REPORT_AFTER, FirstWrites, SetReadings, SetSchedule, due_between
from app.errors import ConstraintError, Problem, StoreError
from app.line.commands.effects import NO_RAMP
from app.line.commands.review import REVIEW_LASTS_S
from app.line.live.bus_live import LiveState
from bus.catalogue.parameters import PARAMETERS
from bus.contract import ParameterValue, UnitLink, UnitLinkState
from bus.instants import unix_now
from bus.messages import Message
from tests.app.complete_app import House
from tests.app.played_commands import ANNA, PlayedCommands, SetScene, a_bus, factory, responding
from tests.app.played_line import played_line
from tests.app.screens import translator

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

    def drift_shown(self, unit: int) -> str:
        return self.drift.summary(unit, translator(), NOON.timestamp()).words

    async def kept(self, unit: int) -> list[str]:
        return [summary.origin for summary in await self.store.summaries("dry-end", unit)]


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scene]:
    made = Scene(tmp_path)
    monkeypatch.setattr("app.engineering.sets.saving.unix_now", lambda: made.now.timestamp())
    yield made
    made.database.close()


BEFORE, AFTER = "before the first write of the day", "after the first write of the day"


async def test_a_set_that_one_person_could_not_save_is_saved_for_the_next(scene: Scene) -> None:
    scene.report(1, *PARAMETERS)
    scene.rights.withdrawn["anna"] = "rights withdrawn"
    with pytest.raises(Problem):
        await scene.first.before(ANNA, [1], parameters=True)
    await scene.first.before(ANNA, [1], parameters=False)
    await scene.first.background.settled()
    assert await scene.kept(1) == []
    await scene.first.before(Person("ben", Role.ENGINEER, "session"), [1], parameters=True)
    assert await scene.kept(1) == [BEFORE]


async def test_before_the_first_parameter_write_known_values_are_saved_and_the_rest_follows(
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


async def test_the_schedule_is_kept_and_ended(scene: Scene) -> None:
    await scene.schedule.set(ANNA, 125)
    assert await scene.store.schedule() == {"dry-end": 125}
    assert "02:05" in scene.events.events[-1]["what"]
    await scene.schedule.set(ANNA, None)
    assert await scene.store.schedule() == {}
    with pytest.raises(ConstraintError):
        await scene.store.set_schedule("dry-end", 1440)


async def test_a_set_keeps_every_value_with_its_evidence(scene: Scene) -> None:
    kept = await scene.keeper.read_and_save(ANNA, [1, 2], "before the felt", "")
    again = await scene.store.load(kept.id)
    assert again is not None
    assert [unit.unit for unit in again.units] == [1, 2]
    row = again.units[0].rows[6]
    assert (row.raw, row.available, row.read_at, row.frame) == (0, True, 1.0, b"\x10")
    (summary,) = await scene.store.summaries("dry-end", 2)
    assert (summary.id, summary.units, summary.who, summary.origin) == (kept.id, (1, 2), "anna", "by hand")
    found = {text: len(await scene.store.summaries(text=text)) for text in ("THE felt", "Anna", "wire")}
    assert found == {"THE felt": 1, "Anna": 1, "wire": 0}


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
    assert taking.values_read(scene.keeper) == {1: 40, 2: 0}
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
    assert scene.drift_shown(1) == "Acceleration Ramp Rate (parameter 6) differs from the golden set"
    scene.report(1, 6, raw=0)
    assert (drift.differing(1), scene.drift_shown(1)) == ([], "")
    with pytest.raises(Problem):
        await scene.keeper.mark_golden(ANNA, kept, [2])


def line(*, run: bool) -> LiveState:
    live = a_bus()
    responding(live, run=run)
    return live


def typed(live: LiveState, number: int, *values: str) -> list[BatchRow]:
    return rows_of_batch(live.buses["dry-end"], number, dict(zip((1, 2), values, strict=True)))


@pytest.mark.parametrize(
    ("number", "run", "warned"),
    [(20, False, True), (20, True, True), (6, True, True), (6, False, False), (12, True, False)],
)
def test_the_review_warns_where_the_machine_changes(number: int, run: bool, warned: bool) -> None:
    assert [bool(row.warning) for row in typed(line(run=run), number, "3", "4")] == [warned, warned]


def test_the_review_warns_of_a_ramp_of_nothing() -> None:
    rows = typed(line(run=False), 7, "0.0", "0.1")
    assert [row.warning for row in rows] == [NO_RAMP, None]


def test_a_speed_or_ratio_is_not_converted_while_it_is_not_known_which_it_is() -> None:
    """A follower's ratio of 1.5, taken for a speed, would be a ratio of 0.0015."""
    live = line(run=False)
    unit = live.buses["dry-end"].units[1]
    assert [row.wanted for row in typed(live, 9, "1.5", "")] == [15, None]
    del unit.parameters[8]
    [row, _] = typed(live, 9, "1.5", "")
    reason = Message.of("unit_mode_unknown", unit=1)
    assert (row.wanted, row.fault) == (None, Message.of("nothing_sent", reason=reason))


def test_a_value_that_moved_since_the_review_is_not_written() -> None:
    live = line(run=False)
    reviewed = {row.unit: row.reviewed for row in typed(live, 6, "20", "")}
    refuse_moved(typed(live, 6, "20", ""), reviewed)
    live.buses["dry-end"].apply([ParameterValue(unit=2, number=6, at=2.0, raw=101)])
    refuse_moved(typed(live, 6, "20", ""), reviewed)
    live.buses["dry-end"].apply([ParameterValue(unit=1, number=6, at=2.0, raw=101)])
    refuse_moved(typed(live, 6, "20", ""), {})
    with pytest.raises(Problem, match="Unwind: the value has changed") as refused:
        refuse_moved(typed(live, 6, "20", ""), reviewed)
    assert (refused.value.status, refused.value.code) == (409, "moved")


async def test_a_refused_value_is_said_at_its_field_with_the_nearest(
    house: House, client: httpx.AsyncClient
) -> None:
    """In the scale of the unit: 99999 s is 999990 raw, and an offer of 9999 would be refused again."""
    live, origin = house.services[LiveState], {"Origin": str(client.base_url)}
    responding(live)
    form = {"number": "7", "unit-1": "5.5", "unit-2": "99999"}
    for action in ("review", "tray"):
        refused = await client.post(f"/batch/dry-end/{action}", data=form, headers=origin)
        assert (refused.status_code, refused.headers["HX-Retarget"]) == (422, "#batch-error")
        assert "out of range; the nearest allowed value is 999.9; nothing was sent<" in refused.text
        assert re.findall('data-use="(.*?)"', refused.text) == ["999.9"]
        assert 'value="5.5"' in refused.text
        assert "<form" not in refused.text


async def test_the_review_counts_only_the_units_that_take_the_value(
    house: House, client: httpx.AsyncClient
) -> None:
    live, origin = house.services[LiveState], {"Origin": str(client.base_url)}
    responding(live)
    live.buses["dry-end"].apply([UnitLink(unit=2, at=2.0, link="offline")])
    form = {"number": "6", "unit-1": "20", "unit-2": "30"}
    review = (await client.post("/batch/dry-end/review", data=form, headers=origin)).text
    assert "Write Acceleration Ramp Rate to 1 unit<" in review
    assert ("unit-1" in review, "unit-2" in review) == (True, False)
    assert 'data-remark="obstacle_offline"' in review
    assert 'name="kept-2" value="30"' in review
    form = {"number": "6", "unit-1": "20", "kept-2": "30", "id": "a", "reviewed_at": str(unix_now())}
    done = (await client.post("/batch/dry-end/write", data=form, headers=origin)).text
    assert 'name="unit-2" value="30"' in done
    assert "left out" in done


async def test_a_dangerous_value_is_not_written_without_the_word(
    house: House, client: httpx.AsyncClient
) -> None:
    responding(house.services[LiveState])
    form = {"number": "27", "unit-1": "1", "id": "a", "reviewed_at": str(unix_now())}
    origin = {"Origin": str(client.base_url)}
    lapsed = form | {"typed": "WRITE", "reviewed_at": str(unix_now() - REVIEW_LASTS_S - 1)}
    assert (await client.post("/batch/dry-end/write", data=lapsed, headers=origin)).status_code == 409
    refused = await client.post("/batch/dry-end/write", data=form, headers=origin)
    assert refused.status_code == 409
    sent = await client.post("/batch/dry-end/write", data=form | {"typed": "WRITE"}, headers=origin)
    assert sent.status_code == 200


def test_the_review_of_a_secret_holds_nothing_of_it() -> None:
    live = line(run=False)
    live.buses["dry-end"].apply([ParameterValue(unit=1, number=21, at=2.0, raw=4711)])
    [row, _] = typed(live, 21, "12", "")
    assert (row.reviewed, row.changes) == ("", True)
    refuse_moved([row], {1: row.reviewed})


@pytest.mark.parametrize(
    ("code", "codes"),
    [
        ("rights_withdrawn", ["rights_withdrawn", False]),
        ("controlled", ["controlled", False]),
        ("blocked", ["blocked", "blocked"]),
    ],
)
async def test_a_refusal_of_the_person_ends_it_and_one_of_a_unit_does_not(
    code: str, codes: list[str | bool]
) -> None:
    live = line(run=False)
    commands = PlayedCommands(
        live,
        {1: factory(), 2: factory()},
        objects={6: Problem(403, code, Message.of("system_error", error="no longer"))},
    )
    rows = typed(live, 6, "20", "30")
    results = await write_batch(commands, ANNA, 6, rows, "a", confirm=False)  # type: ignore[arg-type]
    assert [isinstance(result.part, Problem) and result.part.code for result in results] == codes
    assert {str(getattr(result.part, "message", result.part)) for result in results} == {"no longer"}
    assert len(commands.sent) == codes.count(code)


async def test_a_comparison_says_how_old_its_oldest_value_is_until_all_are_read(
    house: House, client: httpx.AsyncClient
) -> None:
    await played_line(house.services)
    for unit, at in ((1, NOON), (2, NOON + timedelta(hours=1))):
        value = ParameterValue(unit=unit, number=6, at=at.timestamp(), raw=50)
        house.services[LiveState].buses["dry-end"].apply([value])
    address = "/sets/compare?left=live:dry-end:1&right=live:dry-end:2"
    verdict = re.compile(r"<h1>[^·]*· as read at ([^<]*)<")
    page = (await client.get(address)).text
    assert verdict.findall(page)[0].endswith("12:00")
    for read in re.findall(r'hx-post="(/units/[^"]*)"', page):
        assert (await client.post(read)).headers["HX-Refresh"] == "true"
    assert not verdict.findall((await client.get(address)).text)[0].endswith("12:00")
