"""What follows from the readings of a unit: motion, conditions, and since when they hold, also after a
restart."""

from __future__ import annotations

import time
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from app.core.web.access import Role
from app.errors import StoreError
from app.line.live.bus_live import LiveState, Motion, Onset, Onsets, WordSpan, conditions_of, later, onset_in
from app.line.live.change_recorder import OnsetLookup
from app.line.pipeline import Pipeline
from bus.catalogue.values import status_bits
from bus.contract import BusLink, Reading, Snapshot, UnitLink, UnitState
from bus.instants import DAY_S, HOUR_S
from bus.messages import Message
from tests.app.complete_app import House, complete_app
from tests.app.fake_worker import bus_settings, until

AT_SPEED, REMOTE, RUN, HEALTHY = 0x80, 0x40, 0x01, 0x02
STOPPED_BY = pytest.mark.parametrize("inputs", [HEALTHY, RUN, 0], ids=["run off", "e-stop", "both"])


def states(
    *seen: tuple[float, int, int, bool], scan_s: float = 0.2, inputs: int = RUN | HEALTHY, ratio: bool = False
) -> list[str]:
    """The states after readings: when, commanded, actual, at speed."""
    motion = Motion()
    found = []
    for at, commanded, actual, at_speed in seen:
        outputs = REMOTE | (AT_SPEED if at_speed else 0)
        reading = Reading(1, at, commanded, actual, analog=0, outputs=outputs, inputs=inputs)
        found.append(motion.note(reading, status_bits(outputs, inputs), scan_s=scan_s, ratio=ratio))
    return found


def test_nothing_seen_is_no_state() -> None:
    assert Motion().state == ""


def test_the_unit_reports_at_speed() -> None:
    assert states((0, 500, 498, True)) == ["at_speed"]


def test_zero_is_zero_whatever_the_bit() -> None:
    assert states((0, 0, 0, True), (1, 0, 0, False)) == ["at_zero", "at_zero"]


def test_an_error_that_shrinks_is_a_ramp_up_or_down() -> None:
    assert states((0, 500, 0, False), (1, 500, 100, False)) == ["ramping_up", "ramping_up"]
    assert states((0, 0, 500, False), (1, 0, 400, False)) == ["ramping_down", "ramping_down"]


def test_an_error_that_does_not_shrink_is_off_speed_after_patience() -> None:
    seen = [(float(at), 500, 400, False) for at in range(5)]
    assert states(*seen) == ["ramping_up"] * 4 + ["off_speed"]


def test_patience_is_three_scans_where_those_are_long() -> None:
    seen = [(6.6 * at, 500, 400, False) for at in range(5)]
    assert states(*seen, scan_s=6.6) == ["ramping_up"] * 4 + ["off_speed"]


def test_a_unit_that_leaves_its_speed_is_off_speed_only_when_it_was_long_there() -> None:
    held = [(float(at), 500, 500, True) for at in range(10)]
    assert states(*held, (9.2, 500, 450, False))[-1] == "ramping_up"
    assert states(*held, (9.2, 500, 450, False), (13.0, 500, 440, False))[-1] == "off_speed"


def test_a_new_setpoint_is_a_new_ramp() -> None:
    stuck = [(float(at), 500, 400, False) for at in range(6)]
    assert states(*stuck, (6.0, 600, 400, False))[-1] == "ramping_up"


@STOPPED_BY
def test_a_unit_without_run_is_stopped_and_not_off_speed(inputs: int) -> None:
    assert states(*((float(at), 500, 0, False) for at in range(6)), inputs=inputs) == ["stopped"] * 6


@STOPPED_BY
def test_a_unit_without_run_slows_down(inputs: int) -> None:
    coasting = [(float(at), 500, 500 - 50 * at, at < 2) for at in range(11)]
    assert states(*coasting, inputs=inputs) == ["stopping"] * 10 + ["stopped"]


@STOPPED_BY
@pytest.mark.parametrize("commanded", [0, 500])
def test_a_unit_that_goes_on_without_run_turns(commanded: int, inputs: int) -> None:
    """At the commanded speed too: the unit reports at speed, and should not move at all."""
    seen = [(float(at), commanded, 500, commanded == 500) for at in range(5)]
    assert states(*seen, inputs=inputs) == ["stopping"] * 4 + ["turning"]


def test_ratios_do_not_show_whether_the_motor_turns() -> None:
    seen = [(float(at), 10_000, 9_990, False) for at in range(5)]
    assert states(*seen, inputs=HEALTHY, ratio=True) == [""] * 5


@pytest.mark.parametrize(
    ("outputs", "inputs", "actual", "holding"),
    [
        (AT_SPEED | REMOTE, RUN | HEALTHY, 0, set()),
        (AT_SPEED | REMOTE, RUN | HEALTHY, 5, {"turning"}),
        (AT_SPEED | REMOTE, HEALTHY, 0, {"run_off"}),
        (AT_SPEED | REMOTE, RUN, 0, {"estop_active"}),
        (AT_SPEED, RUN | HEALTHY, 0, {"not_in_remote"}),
        (REMOTE, RUN | HEALTHY, 0, {"not_at_speed"}),
        (0, 0, 1, {"estop_active", "run_off", "not_in_remote", "not_at_speed", "turning"}),
    ],
)
def test_each_bit_is_one_condition(outputs: int, inputs: int, actual: int, holding: set[str]) -> None:
    reading = Reading(1, 0.0, 500, actual, analog=0, outputs=outputs, inputs=inputs)
    assert conditions_of(status_bits(outputs, inputs), reading) == holding


def test_the_level_of_the_e_stop_bit_is_the_dialects() -> None:
    reading = Reading(1, 0.0, 500, 0, analog=0, outputs=AT_SPEED | REMOTE, inputs=RUN)
    assert conditions_of(status_bits(reading.outputs, reading.inputs, estop_healthy=0), reading) == set()


OFF, ON = 0, 1
SEEN = 2.0
"""A change between readings that are at most so far apart has a time."""


def off(word: int) -> bool:
    return word == OFF


def after(*readings: tuple[float, set[str]]) -> dict[str, Onset]:
    onsets = Onsets()
    for at, holding in readings:
        onsets.note(at, frozenset(holding), SEEN)  # type: ignore[arg-type]
    return dict(onsets.since)


def test_a_change_that_was_seen_is_exact() -> None:
    assert after((10.0, set()), (10.2, {"run_off"}), (20.0, {"run_off"})) == {"run_off": Onset(10.2)}


def test_what_held_at_the_first_reading_may_be_older() -> None:
    found = after((10.0, {"run_off"}), (10.2, {"run_off", "turning"}))
    assert found == {"run_off": Onset(10.0, exact=False), "turning": Onset(10.2)}


def test_what_ends_and_begins_again_begins_again() -> None:
    assert after((1.0, {"run_off"}), (2.0, set()), (3.0, {"run_off"})) == {"run_off": Onset(3.0)}


def test_a_change_within_a_gap_has_no_time() -> None:
    assert after((10.0, set()), (13.0, {"run_off"})) == {"run_off": Onset(13.0, exact=False)}


@pytest.mark.parametrize(
    ("back_at", "onset"), [(3610.2, Onset(10.2)), (3610.3, Onset(3610.3, exact=False))], ids=["short", "long"]
)
def test_a_state_equal_before_and_after_a_short_gap_went_on(back_at: float, onset: Onset) -> None:
    found = after((10.0, set()), (10.2, {"run_off"}), (back_at, {"run_off"}))
    assert found == {"run_off": onset}


def test_nothing_that_ended_in_a_long_gap_is_left() -> None:
    assert after((10.0, {"run_off"}), (100.0, set())) == {}


@pytest.mark.parametrize(
    ("spans", "onset", "complete"),
    [
        ([(0, 50, ON), (50.2, 100, OFF)], Onset(50.2), True),
        ([(0, 50, ON), (50.2, 60, OFF), (60.2, 100, OFF)], Onset(50.2), True),
        ([(0, 50, OFF), (50.2, 60, ON), (60.2, 100, OFF)], Onset(60.2), True),
        ([(0, 50, ON), (90, 100, OFF)], Onset(90, exact=False), True),
        ([(-9000, -3600, OFF), (90, 100, OFF)], Onset(90, exact=False), True),
        ([(0, 50, ON), (50.2, 80, OFF)], Onset(50.2), True),
        ([(-9000, -3600, OFF)], Onset(100, exact=False), True),
        ([(50, 100, OFF)], Onset(50, exact=False), False),
        ([], Onset(100, exact=False), False),
        ([(50.2, 100, OFF), (100, 130, OFF), (130, 140, ON)], Onset(50.2, exact=False), False),
        ([(0, 99, ON)], Onset(100), True),
    ],
    ids=[
        "the change is there",
        "equal neighbours are one",
        "the last change counts",
        "the change is in a hole",
        "a long hole ends what is known",
        "a restart of twenty seconds is bridged",
        "nothing near the first sight",
        "it began before what is read",
        "nothing is stored",
        "what came later is left out",
        "it changed with the first sight",
    ],
)
def test_the_stored_bits_show_when_it_began(spans: list[WordSpan], onset: Onset, complete: bool) -> None:
    assert onset_in(spans, off, Onset(100, exact=False), SEEN) == (onset, complete)


def test_two_conditions_hold_together_since_the_later_of_them() -> None:
    assert later(Onset(1.0), Onset(2.0, exact=False)) == Onset(2.0, exact=False)
    assert later(Onset(1.0), None) is None


def test_an_onset_that_has_passed_is_not_corrected() -> None:
    onsets = Onsets()
    onsets.note(10.0, frozenset({"run_off"}), SEEN)
    seen = onsets.since["run_off"]
    assert onsets.correct("run_off", seen, Onset(5.0))
    assert onsets.since["run_off"] == Onset(5.0)
    assert not onsets.correct("run_off", seen, Onset(4.0))


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
