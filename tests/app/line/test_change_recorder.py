"""Which changes of a line become events, and where each update of a worker goes."""

from __future__ import annotations

import asyncio
from datetime import datetime
from typing import Any

import pytest
from msgspec import structs

from app.errors import StoreError
from app.line.live import change_recorder
from app.line.live.change_recorder import (
    BURST,
    FEW,
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
from app.people.audit.log import Filter
from bus.contract import Batch, BusFigures, BusLink, UnitLink, Update
from bus.messages import Message, term
from tests.app.complete_app import House
from tests.app.conftest import Kept
from tests.app.fake_worker import HEALTHY, REMOTE, bus_settings, hello, reading, snapshot, until


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
        ((REMOTE, HEALTHY), (REMOTE, 0), ("estop", 1, "healthy", "active")),
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


async def events(site: House, count: int) -> list[dict[str, Any]]:
    """Oldest first, once there are so many."""
    while True:
        found = (await site.http().get("/api/v1/events")).json()["events"]
        found = [event for event in found if event["kind"] != "server"]
        if len(found) >= count:
            return list(reversed(found))


async def test_what_happens_on_the_line_is_written_down_in_order(site: House) -> None:
    worker = await site.worker()
    await worker.update(reading(1))
    local = reading(1, outputs=0)
    await worker.update(local)
    await worker.update(reading(1, outputs=0, inputs=HEALTHY | 1))
    await worker.update(BusLink(at=1.0, link="open"))
    await worker.update(BusLink(at=1.0, link="closed", cause=term("unplugged")))
    found = await events(site, 4)
    assert [(event["kind"], event["unit"], event["old"], event["new"]) for event in found] == [
        ("worker", None, "", "connected"),
        ("mode", 1, "REMOTE", "LOCAL"),
        ("run", 1, "off", "on"),
        ("bus", None, "open", "closed"),
    ]
    assert "unplugged" in found[-1]["what"]
    assert abs(datetime.fromisoformat(found[1]["time"]).timestamp() - local.at) < 0.001
    await site.recorder.recorded()


async def test_workers_come_go_and_come_back(site: House) -> None:
    worker = await site.worker()
    await worker.leave()
    await until(lambda: not site.live.worker_connected, "the loss")
    await site.worker(hello())
    found = await events(site, 3)
    assert "started" in found[0]["what"]
    assert "not connected" in found[1]["what"]
    assert "is back" in found[2]["what"]


async def test_a_worker_that_ran_before_the_server_has_not_started(site: House) -> None:
    """The server was restarted, and the worker of another computer was not."""
    first = hello()
    await site.worker(structs.replace(first, started_at=first.sent_at - 3600))
    assert "is back" in (await events(site, 1))[0]["what"]


async def test_what_happened_while_the_app_was_away_is_written_down_too(site: House, kept: Kept) -> None:
    worker = await site.worker()
    await worker.update(reading(1))
    await until(lambda: len(kept.readings) == 1, "the first reading")
    await worker.leave()
    back = await site.worker(hello(), snapshot(seq=3))
    for seq, outputs in ((2, 0), (3, 0b0100_0000)):
        updates = [reading(1, outputs=outputs)]
        await back.send(Batch(seq=seq, sent_at=0.0, updates=list(updates), live=False))
    found = [event for event in await events(site, 5) if event["kind"] == "mode"]
    assert [event["new"] for event in found] == ["LOCAL", "REMOTE"]
    assert len(kept.readings) == 3


async def test_a_stepped_clock_is_written_down(site: House) -> None:
    site.pipeline.clock_stepped(-3600.0, 5.0)
    found = await events(site, 1)
    assert found[0]["kind"] == "clock"
    assert "-3600" in found[0]["what"]


async def test_a_port_that_flaps_indefinitely_is_few_events_with_a_count(site: House) -> None:
    """Four a second came into a log that is kept for good."""
    for number in range(500):
        links: list[BusLink] = [BusLink(1.0, "open"), BusLink(1.0, "closed", f"closed {number}")]
        site.pipeline.batch(links, live=True)
    await site.recorder.recorded()
    found, _ = await site.log.page(Filter(kind="bus"), 100)
    assert len(found) == FEW + 1
    last = found[0]
    assert (last["what"], last["new"]) == ("port closed: closed 499", "closed")
    assert last["message"].startswith(f"the last of {999 - FEW} events within ")


async def test_a_summary_is_recorded_without_anything_new(
    site: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    later = 0.0
    monkeypatch.setattr(site.recorder, "_monotonic", lambda: later)
    for _ in range(10):
        site.pipeline.batch([BusLink(1.0, "open"), BusLink(1.0, "closed")], live=True)
    later = 3600.0
    await events(site, FEW + 1)
