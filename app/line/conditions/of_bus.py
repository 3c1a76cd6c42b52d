"""The conditions of a bus. Pure."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from app.line.conditions.condition import Condition, ConditionEvent, Tuning
from app.line.conditions.evidence import BusFacts, BusPredicate, CountPredicate
from app.line.conditions.of_unit import MIN_FAULTS
from bus.messages import term

SCAN_BUDGET = 1.5
"""Multiple of the time in which every unit is polled once and takes its full turnaround."""
CONTROL_IDLE_S = 120.0


def _wire_overloaded(bus: BusFacts) -> bool | None:
    """Longer than the cable and its units explain."""
    if not bus.is_readable or bus.scan_s is None:
        return None
    return bus.scan_s > SCAN_BUDGET * bus.longest_scan_s


PORT_LOST: Condition[BusPredicate] = Condition(
    "port_lost",
    ("severe", "minutes"),
    holds=lambda bus: None if bus.worker_is_lost else bus.port_is_closed,
    means="the port of the bus is closed",
    group="bus",
    suppresses=("cable", "unit", "speed"),
    tiles=("port_lost",),
    event=ConditionEvent("bus", "event_port_closed", "event_port_opened", term("open"), term("closed")),
)
NO_UNIT_RESPONDS: Condition[BusPredicate] = Condition(
    "no_unit_responds",
    ("severe", "minutes"),
    holds=lambda bus: bus.has_no_response and bus.lost > 0 if bus.is_readable else None,
    means="no unit of several responds",
    tuning=Tuning(on_delay_s=3, off_delay_s=5),
    group="cable",
    suppresses=("unit", "speed"),
    tiles=("no_unit_responds",),
)
BY_BUS: tuple[Condition[BusPredicate], ...] = (
    Condition(
        "worker_lost",
        ("severe", "minutes"),
        holds=lambda bus: bus.worker_is_lost,
        means="no bus worker is connected, or it reports nothing",
        # A worker that ends is started again and links within seconds, as at the start of the server.
        tuning=Tuning(on_delay_s=10),
        suppresses=("bus", "cable", "unit", "speed"),
        tiles=("worker_lost", "worker_silent"),
    ),
    PORT_LOST,
    NO_UNIT_RESPONDS,
    Condition(
        "wire_overloaded",
        ("minor", "shift"),
        holds=_wire_overloaded,
        means="a scan takes longer than one and a half times the polls of all units with their full"
        " turnaround",
        tuning=Tuning(on_delay_s=60, off_delay_s=60),
        group="unit",
    ),
)
"""Conditions that time alone can change."""
SECOND_MASTER: Condition[CountPredicate] = Condition(
    "second_master",
    ("severe", "half_hour"),
    holds=lambda _, unrequested: unrequested >= MIN_FAULTS,
    means="three responses in a minute that Lineside had not requested",
    tuning=Tuning(off_delay_s=60),
    group="bus",
)
CONTROL_LEFT: Condition[Callable[[float, bool], bool]] = Condition(
    "control_left",
    ("minor", "half_hour"),
    about="drive",
    holds=lambda idle_s, has_page: idle_s > CONTROL_IDLE_S and not has_page,
    means="the holder of control has no page open and has sent no command for two minutes",
    tuning=Tuning(off_delay_s=5),
)
NO_UNIT_YET: Condition[BusPredicate] = Condition(
    "no_unit_yet",
    ("minor", "shift"),
    holds=lambda bus: bus.has_no_response and bus.lost == 0,
    is_alarm=False,
    tiles=("no_unit_yet",),
)

OF_BUS: tuple[Condition[Any], ...] = (*BY_BUS, SECOND_MASTER, CONTROL_LEFT, NO_UNIT_YET)
