"""The values of a unit with their quality, as the status codes of OPC UA, and engineering units. Pure.

`app.system.tags` and the live state determine values and their ages, as everywhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from typing import Any, Literal, NamedTuple

from app.line.live.bus_live import BusLive, UnitLive, unit_link_now
from app.system.opcua.link import StandingAlarm
from app.system.tags import OF_READING, SHOWN_PARAMETERS, Scale, Value, other_values, reading_values
from bus.contract import UnitLinkState
from bus.instants import UnixTime

Quality = Literal["Good", "UncertainLastUsableValue", "BadNoCommunication", "BadWaitingForInitialData"]
"""The status codes by their names in OPC UA Part 8, 6.3."""
QUALITY: dict[UnitLinkState, Quality] = {
    "online": "Good",
    "stale": "UncertainLastUsableValue",
    "offline": "BadNoCommunication",
    "unknown": "BadWaitingForInitialData",
}
UNITS = {
    "m/min": "2X",
    "m/s": "MTS",
    "m/h": "M60",
    "mm/s": "C16",
    "ft/min": "FR",
    "fpm": "FR",
    "rpm": "RPM",
    "1/min": "RPM",
    "U/min": "RPM",
    "%": "P1",
    "s": "SEC",
    "baud": "J38",
    "N": "NEW",
    "kN": "B47",
    "Nm": "NU",
    "kg": "KGM",
    "kg/h": "E93",
    "V": "VLT",
    "mV": "2Z",
    "A": "AMP",
    "mA": "4K",
    "kW": "KWT",
    "Hz": "HTZ",
    "mm": "MMT",
    "m": "MTR",
    "bar": "BAR",
    "psi": "PS",
    "°C": "CEL",
}
"""The units as labels write them, with their common codes (UNECE Recommendation 20)."""
OTHER_UNIT = -1
"""The id of a unit without a common code (OPC UA Part 8, 5.6.3.3)."""


class Point(NamedTuple):
    """A value with its quality and the time of its source. A bad point has no value."""

    value: Value
    quality: Quality
    at: UnixTime


def unit_id(unit: str) -> int:
    """Return the id of an engineering unit: the characters of its common code as a number (OPC UA Part 8,
    5.6.3.3)."""
    code = UNITS.get(unit)
    return OTHER_UNIT if code is None else int.from_bytes(code.encode(), "big")


def unit_points(bus: BusLive, unit: UnitLive, scale: Scale, alarms: int, now: UnixTime) -> tuple[Point, ...]:
    """Return the values of a unit in the order of its tags. ``alarms``: the number of active ones."""
    link = unit_link_now(bus, unit, now)
    reading = unit.reading
    quality = QUALITY[link]
    values = (None,) * OF_READING if reading is None else reading_values(bus, unit, reading, scale)
    at = now if reading is None else reading.at
    state, active, *parameters = other_values(unit, link, alarms)
    return (
        *(_point(value, quality, at) for value in values),
        Point(state, "Good", now),
        Point(active, "Good", now),
        *_parameter_points(unit, parameters, quality, now),
    )


def alarm_lists(alarms: Sequence[StandingAlarm]) -> tuple[list[Any], ...]:
    """Return the names of alarms, their priorities, whether each is active and acknowledged, and since when
    it stands."""
    return (
        [alarm.name for alarm in alarms],
        [alarm.priority for alarm in alarms],
        [alarm.is_active for alarm in alarms],
        [alarm.is_acknowledged for alarm in alarms],
        [datetime.fromtimestamp(float(alarm.since), UTC) for alarm in alarms],
    )


def _parameter_points(
    unit: UnitLive, values: list[Value], quality: Quality, now: UnixTime
) -> Iterator[Point]:
    """Yield the parameters. One not read since the unit came back may have changed at its keypad."""
    for parameter, value in zip(SHOWN_PARAMETERS, values, strict=True):
        known = unit.parameters.get(parameter.number)
        at = now if known is None else known.at
        is_old = quality == "Good" and not unit.is_current(parameter.number)
        yield _point(value, "UncertainLastUsableValue" if is_old else quality, at)


def _point(value: Value, quality: Quality, at: UnixTime) -> Point:
    if quality.startswith("Bad"):
        return Point(None, quality, at)
    return Point(None, "BadWaitingForInitialData", at) if value is None else Point(value, quality, at)
