"""Each condition by its row: when it holds, when it does not, and when that is not known."""

from __future__ import annotations

from decimal import Decimal
from typing import Any

import pytest

from app.line.conditions.catalogue import (
    BUS_ALARMS,
    CONDITIONS,
    SERVER_ALARMS,
    STATUS,
    TILES,
    UNIT_ALARMS,
    tile_check,
    tile_text,
)
from app.line.conditions.condition import (
    NO_DRAW,
    UNKNOWN_DRAW,
    BusFacts,
    Condition,
    Draw,
    LinkFacts,
    Tuning,
    UnitFacts,
)
from app.line.conditions.unit import suspicion
from app.line.feed.plausibility import believed_reading
from app.line.live.bus_live import BusLive
from bus.catalogue.values import status_bits
from bus.contract import BusFigures, ParameterValue, Staged
from bus.instants import UnixTime
from bus.messages import TEXTS
from tests.app.screens import AT_SPEED, HEALTHY, REMOTE, RUN, line, reading

DAY = 86_400.0
HOUR = 3600.0
NOW = UnixTime(1000 * DAY)


def unit(outputs: int = AT_SPEED | REMOTE, inputs: int = RUN | HEALTHY, **more: Any) -> UnitFacts:
    facts = UnitFacts(status_bits(outputs, inputs), "at_speed", commanded=1200, actual=1200)
    return facts._replace(**more)


def live(**raw: int) -> BusLive:
    """Three units; parameters of the first one, ``p8`` is #8."""
    bus = line(units=3).buses["dry"]
    bus.apply(
        [ParameterValue(unit=1, number=int(name[1:]), at=NOW, raw=value) for name, value in raw.items()]
    )
    return bus


def of(bus: BusLive) -> tuple[Any, Any]:
    return bus, bus.units[1]


def value_of(passes: bool, motion: str = "at_speed", **raw: int) -> tuple[Any, ...]:
    bus = live(**raw)
    bus.units[1].motion.state = motion  # type: ignore[assignment]
    return *of(bus), reading(1, actual=1100), lambda *_: passes


def deviation_without_full_scale() -> tuple[Any, ...]:
    found = value_of(True)
    del found[1].parameters[2]
    return found


def analog(motion: str = "at_speed") -> tuple[Any, ...]:
    found = value_of(True, motion)
    labels = found[1].settings.labels.model_copy(update={"analog": "Tension"})
    found[1].settings = found[1].settings.model_copy(update={"labels": labels})
    return found


def staged() -> BusLive:
    bus = live()
    bus.apply([Staged(unit=1, at=NOW, raw=100)])
    return bus


def implausible() -> BusLive:
    bus = live()
    bus.apply([believed_reading(reading(1, actual=4_294_967_196))])
    return bus


def followers(ratio: int) -> BusLive:
    return live(p8=1, p37=ratio, p38=100, p31=200)


def addresses(*own: int) -> BusLive:
    bus = line(units=3).buses["dry"]
    bus.apply([ParameterValue(unit=n + 1, number=17, at=NOW, raw=raw) for n, raw in enumerate(own)])
    return bus


LINK = LinkFacts(bus_is_readable=True, is_lost=False, is_online=True, is_alone=False)
BUS = BusFacts(False, False, units=3, lost=1, unread=1, scan_s=1.0, longest_scan_s=1.0)
CLOSED, GONE = BUS._replace(port_is_closed=True), BUS._replace(worker_is_lost=True)
NEVER: list[tuple[Any, ...]] = []

EXAMPLES: dict[str, tuple[list[tuple[Any, ...]], list[tuple[Any, ...]], list[tuple[Any, ...]]]] = {
    "estop_active": ([(unit(inputs=RUN),)], [(unit(),)], NEVER),
    "running_without_run": ([(unit(motion="turning"),)], [(unit(motion="stopping"),)], NEVER),
    "run_off": ([(unit(inputs=HEALTHY),)], [(unit(),), (unit(inputs=HEALTHY, commanded=0),)], NEVER),
    "not_in_remote": ([(unit(outputs=AT_SPEED),)], [(unit(),)], NEVER),
    "link_stale": ([(unit(is_late=True),)], [(unit(),)], NEVER),
    "not_at_speed": (
        [(unit(motion="off_speed"),)],
        [(unit(),), (unit(motion="off_speed", is_late=True),)],
        NEVER,
    ),
    "deviation": (
        [value_of(True)],
        [value_of(False), value_of(True, "ramping_up")],
        [deviation_without_full_scale()],
    ),
    "draw_out_of_band": (
        [(Draw("out_of_band", 53),)],
        [(Draw("in_band", 3),), (Draw("none", 53),), (NO_DRAW,)],
        [(UNKNOWN_DRAW,)],
    ),
    "analog_out_of_limits": ([analog()], [analog("stopped"), value_of(True)], NEVER),
    "ratio_out_of_limits": (
        [of(followers(99)), of(followers(201))],
        [of(followers(100)), of(live())],
        [of(live(p8=1))],
    ),
    "duplicate_address": ([of(addresses(9, 2, 3))], [of(addresses(1, 2, 3)), of(addresses(9, 8, 7))], NEVER),
    "staged_left": ([of(staged())], [of(live())], NEVER),
    "value_implausible": (
        [of(live(p3=5)), of(live(p2=100_000)), of(live(p21=100_000)), of(implausible())],
        [of(live()), of(live(p3=4, p31=79_999))],
        NEVER,
    ),
    "unit_offline": (
        [(LINK._replace(is_lost=True),)],
        [(LINK,)],
        [
            (LINK._replace(bus_is_readable=False),),
            (LINK._replace(is_online=False),),
            (LINK._replace(is_lost=True, is_alone=True),),
        ],
    ),
    "unit_unknown": ([(False,)], [(True,)], NEVER),
    "link_degraded": ([(60, 3), (100, 5)], [(10, 2), (1000, 49)], NEVER),
    "parameter_drift": ([(True,), ("#6",)], [(False,), ("",)], NEVER),
    "blocked": ([("belt off",)], [(None,)], NEVER),
    "worker_lost": ([(GONE,)], [(BUS,), (CLOSED,)], NEVER),
    "port_lost": ([(CLOSED,)], [(BUS,)], [(GONE,)]),
    "no_unit_responds": (
        [(BUS._replace(lost=3, unread=0),), (BUS._replace(lost=2),)],
        [(BUS,), (BUS._replace(lost=0, unread=3),), (BUS._replace(units=1, unread=0),)],
        [(GONE,), (CLOSED,)],
    ),
    "wire_overloaded": (
        [(BUS._replace(scan_s=1.51),)],
        [(BUS._replace(scan_s=1.5),)],
        [(CLOSED,), (BUS._replace(scan_s=None),)],
    ),
    "second_master": ([(0, 3)], [(0, 2)], NEVER),
    "control_left": ([(121.0, False)], [(121.0, True), (120.0, False)], NEVER),
    "no_unit_yet": (
        [(BUS._replace(lost=0, unread=3),)],
        [(BUS._replace(lost=2),), (BUS._replace(lost=0),), (BUS._replace(units=1, lost=0),)],
        NEVER,
    ),
    "history_degraded": ([("paused",), ("failed",)], [("ok",), ("low",), ("following",)], NEVER),
    "audit_degraded": ([(True,)], [(False,)], NEVER),
    "disk_low": ([("low",), ("scarce",), ("paused",)], [("ok",), ("failed",)], NEVER),
    "notification_failed": ([(True,)], [(False,)], NEVER),
    "clock_stepped": ([(-1.0,)], [(0.0,)], NEVER),
    "certificate_expiring": ([(NOW + 29 * DAY, NOW), (NOW - DAY, NOW)], [(NOW + 31 * DAY, NOW)], NEVER),
    "backup_overdue": (
        [(NOW - 27 * HOUR, NOW)],
        [(NOW - 25 * HOUR, NOW), (None, NOW), (NOW + HOUR, NOW)],
        NEVER,
    ),
    "publisher_behind": ([(301.0,)], [(0.0,), (299.0,)], NEVER),
    "publisher_day_behind": ([(DAY + 1,)], [(DAY - 1,)], NEVER),
    "broker_lost": ([(True,)], [(None,)], NEVER),
    "opcua_lost": ([(True,)], [(None,)], NEVER),
    "events_not_archived": ([(True,)], [(None,)], NEVER),
    "token_expiring": (
        [(NOW - 300 * DAY, NOW + DAY, NOW, NOW)],
        [
            (NOW - 300 * DAY, NOW + 20 * DAY, NOW, NOW),
            (NOW, None, NOW, NOW),
            (NOW - DAY, NOW + DAY, None, NOW),
        ],
        NEVER,
    ),
}
"""Of each row: what it holds by, what it does not hold by, and what leaves it unknown."""


@pytest.mark.parametrize("row", CONDITIONS.values(), ids=lambda row: row.code)
def test_a_condition_holds_by_its_evidence(row: Condition[Any]) -> None:
    assert row.code in EXAMPLES, f"{row.code} has no test"
    held, ended, unknown = EXAMPLES[row.code]
    assert held
    assert ended
    assert [row.holds(*each) for each in held] == [True] * len(held)
    assert [row.holds(*each) for each in ended] == [False] * len(ended)
    assert [row.holds(*each) for each in unknown] == [None] * len(unknown)


def test_no_example_is_left_of_a_row_that_is_gone() -> None:
    assert set(EXAMPLES) == set(CONDITIONS)


def test_a_ratio_is_not_known_before_the_mode_is_and_a_ratio_is_no_deviation() -> None:
    bus = live()
    del bus.units[1].parameters[8]
    assert CONDITIONS["ratio_out_of_limits"].holds(bus, bus.units[1]) is None
    found = value_of(True, p8=1)
    found[0].settings = found[0].settings.model_copy(update={"follower_speed": "ratio"})
    assert CONDITIONS["deviation"].holds(*found) is False


def test_responses_that_come_twice_are_a_sign_of_a_foreign_unit() -> None:
    bus = live()
    figures = BusFigures(
        at=NOW, scan_hz=5, scan_s=0.2, wire_utilisation=0.9, scan_s_with_one_more=0.3, responds_for_all=2
    )
    bus.apply([figures])
    assert (found := suspicion(*of(bus))) is not None
    assert found.code == "suspect_by_duplicates"
    assert suspicion(bus, bus.units[2]) is None, "it is that unit itself"


def test_a_rung_is_broken_while_the_motor_coasts_though_that_is_not_abnormal() -> None:
    row = CONDITIONS["run_off"]
    coasting = unit(inputs=HEALTHY, commanded=0)
    assert row.broken is not None
    assert (row.broken(coasting), row.holds(coasting)) == (True, False)
    assert not row.broken(coasting._replace(actual=0))


@pytest.mark.parametrize(
    ("code", "outputs", "inputs"),
    [
        ("estop_active", AT_SPEED | REMOTE, RUN),
        ("run_off", AT_SPEED | REMOTE, HEALTHY),
        ("not_in_remote", AT_SPEED, RUN | HEALTHY),
        ("not_at_speed", REMOTE, RUN | HEALTHY),
    ],
)
def test_a_status_bit_is_that_of_one_condition(code: str, outputs: int, inputs: int) -> None:
    assert [name for name, holds in STATUS.items() if holds(status_bits(outputs, inputs))] == [code]


def test_a_row_without_a_text_does_not_start(monkeypatch: pytest.MonkeyPatch) -> None:
    def row(code: str, **more: Any) -> Condition[Any]:
        return Condition(code, ("minor", "shift"), holds=bool, **more)

    with pytest.raises(ValueError, match="condition flood has no text: alarm_flood, alarm_flood_cause, "):
        row("flood", means="water is in the cabinet")
    with pytest.raises(ValueError, match="condition deviation has no text: what it means"):
        row("deviation")
    with pytest.raises(ValueError, match="condition flood has no text"):
        row("flood", is_alarm=False)
    for code in ("alarm_flood", "alarm_flood_cause", "alarm_flood_consequence", "alarm_flood_response"):
        monkeypatch.setitem(TEXTS, code, "Flood")
    assert row("flood", means="water is in the cabinet").priority == "low"


def test_a_tile_has_the_words_of_its_cause() -> None:
    assert str(tile_text("not_in_remote")) == "not in REMOTE"
    assert str(tile_check("worker_silent")) == "Check that the bus worker runs and reaches this server"
    assert tile_text("drift") is None, "it names the parameters"
    assert tile_check("blocked") is None, "a person has decided that"


def test_a_condition_is_in_the_alarms_of_one_place() -> None:
    codes = (*UNIT_ALARMS, *BUS_ALARMS, *SERVER_ALARMS)
    assert len(codes) == len(set(codes))
    assert {row.code for row in CONDITIONS.values() if not row.is_alarm} == set(CONDITIONS) - set(codes)
    assert {"worker_silent", "address_suspect", "drift"} <= set(TILES), "codes that programs read"


@pytest.mark.parametrize(
    ("tuning", "fault"),
    [
        (Tuning(), ""),
        (Tuning(Decimal(5), None, Decimal(4)), ""),
        (Tuning(Decimal(5), None, Decimal(5)), "setting_alarm_deadband_wide"),
        (Tuning(Decimal(5), Decimal(5)), "setting_alarm_limits_reversed"),
        (Tuning(Decimal(9), Decimal(5), Decimal(2)), "setting_alarm_deadband_wide"),
    ],
)
def test_limits_that_no_value_can_keep_are_a_fault(tuning: Tuning, fault: str) -> None:
    assert tuning.fault == fault
