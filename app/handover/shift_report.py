"""The report of a shift from the stores alone: run time, stops and length of each unit, the alarms that came,
and the sheet of the hand-over."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, NotRequired

from typing_extensions import TypedDict

from app.alarms.shown import transition_json
from app.alarms.store import JournalEntry
from app.database import StoreConnection
from app.handover.rules.shift_times import Shift
from app.handover.sheet import signed_json, write_sheet
from app.handover.signatures import signed_sheet
from app.history.query.unit_report import stored_tail, unit_figures
from app.history.series.run_time import RunFigures, StopCause
from app.history.series.runs import SECOND, micros
from app.settings import Settings
from app.web.shape import iso
from bus.instants import UnixTime
from bus.settings import BusSettings, UnitSettings

MAX_ALARMS = 200
PER_S = {"s": 1, "sec": 1, "min": 60, "h": 3600}
"""Seconds in the time of a unit of speed, such as m/min."""
_CAME = (
    f"SELECT {', '.join(field.name for field in fields(JournalEntry))} FROM alarm_journal"
    " WHERE trigger = 'rise' AND at >= ? AND at < ? ORDER BY at, id LIMIT ?"
)


class StopShown(TypedDict):
    """A time in which a unit stood still."""

    start: str
    end: str
    seconds: float
    cause: StopCause


class UnitRun(TypedDict):
    """What a unit did in a shift. ``known_s``: for how long it was read. Without ``running_s`` its readings
    are ratios to a master. ``length``: where its label states a speed, such as m/min."""

    bus: str
    unit: int
    name: str
    known_s: NotRequired[float]
    running_s: NotRequired[float]
    by_minute: NotRequired[bool]
    stops: NotRequired[list[StopShown]]
    length: float | None
    length_unit: str | None


def shift_report(
    connection: StoreConnection,
    history: StoreConnection | None,
    settings: Settings,
    shift: Shift,
    now: UnixTime,
) -> dict[str, Any]:
    """The report as the stores are; in a transaction. ``shift``: any span. ``history``: None where there is
    none."""
    until, signed = min(shift.end, now), signed_sheet(connection, shift.start)
    came = connection.execute(_CAME, (shift.start, until, MAX_ALARMS))
    return {
        **write_sheet(connection, settings, shift, now),
        "signed": signed_json(signed if signed and signed.shift == shift else None),
        "units": [] if history is None else _units(history, settings, shift.start, until),
        "alarms": [transition_json(JournalEntry(*row)) for row in came],
    }


def _units(history: StoreConnection, settings: Settings, start: UnixTime, until: UnixTime) -> list[UnitRun]:
    tail = stored_tail(history)
    return [
        _unit(bus, unit, unit_figures(history, tail, bus, unit.id, micros(start), micros(until)))
        for bus in settings.bus
        for unit in bus.unit
    ]


def _unit(bus: BusSettings, unit: UnitSettings, figures: RunFigures | None) -> UnitRun:
    shown: UnitRun = {
        "bus": bus.name,
        "unit": unit.id,
        "name": unit.name,
        "length": None,
        "length_unit": None,
    }
    if figures is None:
        return shown
    shown["known_s"] = figures.known / SECOND
    shown["running_s"] = figures.running / SECOND
    shown["by_minute"] = figures.by_minute
    shown["stops"] = [
        {
            "start": iso(UnixTime(stop.at / SECOND)),
            "end": iso(UnixTime(stop.until / SECOND)),
            "seconds": (stop.until - stop.at) / SECOND,
            "cause": stop.cause,
        }
        for stop in figures.stops
    ]
    length_unit, _, per = unit.labels.unit.strip().partition("/")
    if length_unit and per.strip() in PER_S:
        shown["length"] = round(figures.travel / SECOND / PER_S[per.strip()], 3)
        shown["length_unit"] = length_unit.strip()
    return shown
