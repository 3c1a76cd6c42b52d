"""Which changes of a line become events, how many of a series, and what becomes of those that cannot be
written."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from app.errors import StoreError
from app.line.live import change_recorder
from app.line.live.change_recorder import (
    BURST,
    FIRST_PAUSE_S,
    FORGIVEN_EVERY_S,
    MAX_PAUSE_S,
    QUIET_S,
    ChangeDetector,
    ChangeRecorder,
    EventBudget,
    LineEvent,
    Summary,
)
from bus.contract import BusFigures, BusLink, UnitLink, Update
from bus.messages import Message, term
from tests.app.fake_worker import HEALTHY, REMOTE, bus_settings, reading


def seen(*updates: Update, **settings: object) -> list[tuple[str, int | None, str, str]]:
    """Kind, unit, old and new of every change."""
    changes = ChangeDetector(bus_settings(**settings))
    found: list[LineEvent] = []
    for update in updates:
        found += changes.detect(update)
    return [(change.kind, change.unit, str(change.old), str(change.new)) for change in found]


def link(state: str, unit: int = 1) -> UnitLink:
    return UnitLink(unit=unit, at=1.0, link=state, cause=term("no response"))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("before", "after", "change"),
    [
        ((REMOTE, HEALTHY), (0, HEALTHY), ("mode", 1, "REMOTE", "LOCAL")),
        ((0, HEALTHY), (REMOTE, HEALTHY), ("mode", 1, "LOCAL", "REMOTE")),
        ((REMOTE, HEALTHY), (REMOTE, 0), ("estop", 1, "healthy", "active")),
        ((REMOTE, 0), (REMOTE, HEALTHY), ("estop", 1, "active", "healthy")),
        ((REMOTE, HEALTHY), (REMOTE, HEALTHY | 1), ("run", 1, "off", "on")),
    ],
)
def test_a_changed_bit(
    before: tuple[int, int], after: tuple[int, int], change: tuple[str, int, str, str]
) -> None:
    first, second = (reading(1, outputs=outputs, inputs=inputs) for outputs, inputs in (before, after))
    assert seen(first, second) == [change]


def test_the_first_reading_and_an_equal_one_are_no_change() -> None:
    assert seen(reading(1), reading(1, 2000), reading(2, outputs=0), reading(1, outputs=REMOTE | 3)) == []


def test_the_dialect_defines_the_emergency_stop_level() -> None:
    assert seen(reading(1, inputs=HEALTHY), reading(1, inputs=0), estop_healthy=0) == [
        ("estop", 1, "active", "healthy")
    ]


def test_a_unit_lost_and_back_but_not_a_late_response() -> None:
    assert seen(link("online"), link("stale"), link("online")) == []
    assert seen(link("unknown"), link("online"), link("stale"), link("offline"), link("online")) == [
        ("unit", 1, "online", "offline"),
        ("unit", 1, "offline", "online"),
    ]


def test_what_another_program_does_to_the_port_is_one_event() -> None:
    def figures(*diagnosis: Message) -> BusFigures:
        return BusFigures(2.0, 1.0, 1.0, 0.5, 1.0, diagnosis=list(diagnosis))

    changed = Message.of("diagnosis_port_changed", changed=["echo"])
    other = Message.of("diagnosis_port_changed", changed=["1200 baud"])
    echo = Message("diagnosis_echo")
    updates = (figures(echo), figures(changed, echo), figures(changed), figures(other, changed), figures())
    changes = ChangeDetector(bus_settings())
    found = [str(event.what) for update in updates for event in changes.detect(update)]
    assert found == [
        "Another program changed the settings of the port: echo. They were put back.",
        "Another program changed the settings of the port: 1200 baud. They were put back.",
    ]


def test_a_closed_port_is_one_change_and_not_one_for_each_unit() -> None:
    opened, closed = BusLink(at=1.0, link="open"), BusLink(at=2.0, link="closed", cause=term("unplugged"))
    assert seen(opened, link("online"), link("online", 2), closed, link("offline"), link("offline", 2)) == [
        ("bus", None, "open", "closed")
    ]
    assert seen(opened, BusLink(at=1.0, link="open", baud=4800)) == [], "another rate is no news of the port"
    assert seen(opened, closed, opened) == [("bus", None, "open", "closed"), ("bus", None, "closed", "open")]


KEY = ("run", 1)


def spent(now: float = 0.0) -> EventBudget:
    """A series that has had its share."""
    budget = EventBudget()
    assert all(budget.admits(KEY, number, now) for number in range(BURST))
    return budget


def test_few_events_are_recorded_one_by_one() -> None:
    budget = EventBudget()
    admitted = [budget.admits(KEY, hour, 3600.0 * hour) for hour in range(100)]
    assert all(admitted)
    assert budget.due(1e9) == []


def test_the_last_of_a_flood_is_recorded_once_it_is_quiet() -> None:
    budget = spent()
    assert not any(budget.admits(KEY, number, 10.0) for number in (100, 101, 102))
    assert budget.due(10.0 + QUIET_S - 1) == []
    assert budget.due(10.0 + QUIET_S) == [Summary(102, 3, QUIET_S)]
    assert budget.due(1e6) == []


def test_a_flood_without_end_is_recorded_ever_more_seldom() -> None:
    """A port that opens and closes each second, for a day."""
    budget, recorded, at = spent(), 0, 0.0
    while at < 86_400.0:
        at += 1.0
        recorded += budget.admits(KEY, 0, at)
        recorded += len(budget.due(at))
    assert 86_400 / MAX_PAUSE_S < recorded < 40


def test_a_series_that_was_quiet_for_long_has_its_share_again() -> None:
    budget = spent()
    assert not budget.admits(KEY, 1, 1.0)
    budget.due(FIRST_PAUSE_S + QUIET_S)
    later = FIRST_PAUSE_S + QUIET_S + BURST * FORGIVEN_EVERY_S
    assert all(budget.admits(KEY, number, later) for number in range(BURST))


def test_one_series_does_not_crowd_out_another() -> None:
    budget = spent()
    assert not budget.admits(KEY, 1, 1.0)
    assert budget.admits(("run", 2), 1, 1.0)


def test_nothing_is_lost_when_the_server_ends() -> None:
    budget = spent()
    budget.admits(KEY, 7, 1.0)
    assert budget.due(1.0, everything=True) == [Summary(7, 1, 0.0)]


def test_a_series_that_is_over_takes_no_memory() -> None:
    budget = EventBudget()
    for number in range(100):
        budget.admits(number, 0, 0.0)
    budget.due(2 * FORGIVEN_EVERY_S)
    assert budget._series == {}


class Log:
    """An event log whose disk takes nothing until it ``is_writable``."""

    def __init__(self) -> None:
        self.is_writable = False
        self.refused = asyncio.Event()
        self.recorded: list[dict[str, Any]] = []

    async def record(self, **event: Any) -> int:
        if not self.is_writable:
            self.refused.set()
            raise StoreError(Message("store_disk_full"))
        self.recorded.append(event)
        return len(self.recorded)


async def test_the_oldest_are_left_out_and_counted_in_one_event(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(change_recorder, "MAX_WAITING", 5)
    monkeypatch.setattr(change_recorder, "RETRY_AFTER_S", 0.0)
    log = Log()
    recorder = ChangeRecorder(log, "dry-end")  # type: ignore[arg-type]
    following = asyncio.create_task(recorder.follow())
    for unit in range(1, 21):
        recorder.note(LineEvent("run", unit, 5.0, Message("event_run_input"), "on", "off"))
        if unit == 1:
            await log.refused.wait()
    log.is_writable = True
    await recorder.recorded()
    following.cancel()
    assert [event["unit"] for event in log.recorded] == [1, *range(16, 21), None]
    assert (
        str(log.recorded[-1]["what"])
        == "14 changes of the line are missing here: the log could not be written"
    )
    assert log.recorded[-1]["kind"] == "audit"


async def test_a_port_that_comes_and_goes_each_second_is_a_few_events_an_hour(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    log = Log()
    log.is_writable = True
    recorder, now = ChangeRecorder(log, "dry-end"), 0.0  # type: ignore[arg-type]
    monkeypatch.setattr(recorder, "_monotonic", lambda: now)
    following = asyncio.create_task(recorder.follow())
    for second in range(3600):
        now = float(second)
        old, new = ("open", "closed") if second % 2 else ("closed", "open")
        recorder.note(LineEvent("bus", None, now, Message("event_port"), old, new))
        recorder._note_due()
    await recorder.recorded()
    following.cancel()
    assert len(log.recorded) < 80
    assert log.recorded[-1]["new"] == "closed", "the last state is never left out"
    counted = sum(event["message"].params["n"] if event["message"] else 1 for event in log.recorded)
    assert counted == 3600
