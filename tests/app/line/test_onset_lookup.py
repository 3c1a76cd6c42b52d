"""After a restart the time of a change comes from what was stored, and never from the restart."""

from __future__ import annotations

import time
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from app.core.web.access import Role
from app.errors import StoreError
from app.line.live.bus_live import LiveState, Onset, WordSpan
from app.line.live.change_recorder import DAY_S, HOUR_S, OnsetLookup
from app.line.pipeline import Pipeline
from bus.contract import BusLink, Reading, Snapshot, UnitLink, UnitState
from bus.messages import Message
from tests.app.complete_app import House, complete_app
from tests.app.fake_worker import bus_settings, until

AT_SPEED, REMOTE, RUN, HEALTHY = 0x80, 0x40, 0x01, 0x02
WELL = (AT_SPEED | REMOTE) << 8 | RUN | HEALTHY
RUN_OFF = (AT_SPEED | REMOTE) << 8 | HEALTHY
SEEN_AT = 10 * DAY_S


def reading(at: float, word: int, unit: int = 1) -> Reading:
    return Reading(unit, at, 1000, 0, 51, word >> 8, word & 0xFF)


class Scene:
    """A line that was first seen with its run input off, and what is stored of it."""

    def __init__(self, *spans: WordSpan, fails: int = 0) -> None:
        self.spans, self.fails = list(spans), fails
        self.now = SEEN_AT
        self.queried_spans: list[float] = []
        self.changed: list[tuple[str, int]] = []
        self.live = LiveState([bus_settings()], SEEN_AT)
        self.live.buses["dry-end"].apply([reading(SEEN_AT, RUN_OFF)])
        self.lookup = OnsetLookup(
            self.live, self.words, lambda bus, unit: self.changed.append((bus, unit)), lambda: self.now
        )

    async def words(self, _bus: str, unit: int, start: float, end: float) -> Sequence[WordSpan]:
        if unit != 1:
            return []
        self.queried_spans.append(end - start)
        if self.fails:
            self.fails -= 1
            raise StoreError(Message.of("system_error", error="the disk is away"))
        return [span for span in self.spans if span[1] >= start and span[0] <= end]

    async def look(self, after_s: float) -> Onset:
        self.now = SEEN_AT + after_s
        await self.lookup.look()
        return self.live.buses["dry-end"].units[1].onsets.since["run_off"]


CHANGED_AT = SEEN_AT - 3 * HOUR_S
HELD: tuple[WordSpan, ...] = (
    (CHANGED_AT - HOUR_S, CHANGED_AT - 0.2, WELL),
    (CHANGED_AT, SEEN_AT - 20, RUN_OFF),
)


async def test_the_stored_change_replaces_the_first_reading() -> None:
    scene = Scene(*HELD)
    assert await scene.look(0.5) == Onset(SEEN_AT, exact=False), "the history has not stored it yet"
    assert scene.queried_spans == []
    assert await scene.look(1.0) == Onset(CHANGED_AT)
    assert scene.changed == [("dry-end", 1)]
    assert scene.queried_spans == [HOUR_S, DAY_S], "no further back than needed"
    await scene.look(11.0)
    assert len(scene.queried_spans) == 2


async def test_what_a_worker_delivers_late_is_found_later() -> None:
    scene = Scene()
    assert await scene.look(1.0) == Onset(SEEN_AT, exact=False)
    assert scene.changed == []
    scene.spans = list(HELD)
    assert await scene.look(9.0) == Onset(SEEN_AT, exact=False), "history is not queried all the time"
    assert await scene.look(10.0) == Onset(CHANGED_AT)


async def test_an_onset_that_is_not_stored_stays_first_seen_and_is_queried_thrice() -> None:
    scene = Scene()
    for seconds in (1.0, 2.0, 10.0, 30.0, 60.0, 90.0, 900.0):
        assert await scene.look(seconds) == Onset(SEEN_AT, exact=False)
    assert len(scene.queried_spans) == 3 * 5


async def test_a_failing_store_is_queried_again_at_the_next_time() -> None:
    scene = Scene(*HELD, fails=1)
    assert await scene.look(1.0) == Onset(SEEN_AT, exact=False)
    assert await scene.look(10.0) == Onset(CHANGED_AT)


async def test_a_condition_that_has_passed_meanwhile_is_left_alone() -> None:
    scene = Scene(*HELD)
    scene.live.buses["dry-end"].apply([reading(SEEN_AT + 0.2, WELL)])
    scene.now = SEEN_AT + 5
    await scene.lookup.look()
    assert scene.changed == []


async def test_a_unit_that_does_not_respond_since_the_start_has_the_time_of_its_last_response() -> None:
    scene = Scene(*HELD, fails=1)
    scene.live = LiveState([bus_settings()], SEEN_AT)
    scene.lookup = OnsetLookup(scene.live, scene.words, lambda _bus, _unit: None, lambda: scene.now)
    units = scene.live.buses["dry-end"].units
    await scene.lookup.look()
    assert units[1].last_response is None, "the store could not be read"
    await scene.lookup.look()
    assert (units[1].last_response, units[2].last_response) == (SEEN_AT - 20, None)


# --- the complete app, restarted ---------------------------------------------------------------------


def snapshot(word: int, at: float) -> Snapshot:
    """A worker's first word."""
    states = [UnitState(1, UnitLink(unit=1, at=at, link="online"), reading(at, word), [])]
    return Snapshot(seq=0, sent_at=at, bus=BusLink(at=at, link="open"), units=states)


def take(house: House, *readings: Reading) -> None:
    house.services.buses["dry-end"][Pipeline].batch(list(readings), live=True)


async def cause_of(house: House, token: str) -> dict[str, Any]:
    client = house.client(Authorization=f"Bearer {token}")
    cause = (await client.get("/api/v1/buses/dry-end/units/1")).json()["cause"]
    assert isinstance(cause, dict)
    return cause


async def test_after_a_restart_the_api_has_the_true_onset(tmp_path: Path) -> None:
    now = time.time()
    changed_at = round(now - 40, 3)
    async with complete_app(tmp_path) as house:
        token = await house.token(Role.VIEWER)
        house.services.buses["dry-end"][Pipeline].snapshot(snapshot(WELL, now - 60))
        well = [reading(now - 60 + n / 5, WELL) for n in range(100)]
        off = [reading(changed_at + n / 5, RUN_OFF) for n in range(100)]
        take(house, *well, *off)
    async with complete_app(tmp_path) as house:
        house.services.buses["dry-end"][Pipeline].snapshot(snapshot(RUN_OFF, time.time()))
        first = await cause_of(house, token)
        onsets = house.services[LiveState].buses["dry-end"].units[1].onsets
        await until(lambda: onsets.since["run_off"].exact, "the time of the change")
        found = await cause_of(house, token)
    assert (first["code"], first["since_exact"]) == ("run_off", False)
    assert first["detail"].startswith("Stopped: run input off since at least ")
    assert (found["code"], found["since_exact"]) == ("run_off", True)
    assert found["detail"] == first["detail"].replace("at least ", "")[:-5] + found["detail"][-5:]
    assert abs(datetime.fromisoformat(found["since"]).timestamp() - changed_at) < 0.01
