"""The report of a span, read from the stores: the activity of each unit, the alarms, and the contents of a
handover sheet."""

from __future__ import annotations

from dataclasses import fields
from sys import maxsize
from typing import Annotated, Any, NamedTuple, NotRequired, cast

from pydantic import Field
from typing_extensions import TypedDict

from app.core.database import StoreConnection
from app.core.web.shape import Instant, iso
from app.line.alarms.api import AlarmStateShown, AlarmTransition, transition_json
from app.line.alarms.journal import JournalEntry
from app.line.alarms.rules import AlarmState
from app.line.history.report import UnitReport
from app.line.history.series.figures import DrawFigures, RunFigures, StopCause
from app.line.history.series.runs import SECOND
from app.records.handover.figures import (
    DIGITS,
    RISEN,
    FoundUnits,
    count_alarms,
    length_of,
    line_figures,
)
from app.records.handover.notes import MAX_OF_SPAN
from app.records.handover.rules import Scope, Shift
from app.records.handover.sheet import (
    ShiftAlarm,
    ShiftSignatures,
    SignedShiftSheet,
    alarm_json,
    alarms_before,
    signed_json,
    write_sheet,
)
from app.records.handover.signatures import signed_sheet
from app.settings import Settings
from bus.instants import UnixTime
from bus.settings import BusSettings, UnitSettings

_MAX_ALARMS = 200
_COLUMNS = ", ".join(field.name for field in fields(JournalEntry))
_AT_END = """(
    SELECT l.after FROM alarm_journal l WHERE l.alarm = j.alarm AND l.at < ? AND l.id < COALESCE((
        SELECT n.id FROM alarm_journal n WHERE n.alarm = j.alarm AND n.id > j.id AND n.trigger = 'rise'
        ORDER BY n.id LIMIT 1
    ), 9223372036854775807) ORDER BY l.id DESC LIMIT 1
)"""
"""SQL that selects the state of an alarm at the end of a span."""
_AGAIN = """(
    SELECT n.at FROM alarm_journal n
    WHERE n.alarm = j.alarm AND n.id > j.id AND n.at < ? AND n.trigger = 'rise' ORDER BY n.id LIMIT 1
)"""
"""SQL that selects when an alarm came again in a span."""
_COMMANDS = "FROM events WHERE about IS NULL AND kind = 'command' AND time >= ? AND time < ?"


class ReportedStop(TypedDict):
    """A time within the span in which a unit stood still."""

    start: Instant
    end: Instant
    seconds: Annotated[float, Field(description="How long it lasted within the span.")]
    before: Annotated[bool, Field(description="Whether the unit stood already as the readings begin.")]
    goes_on: Annotated[bool, Field(description="Whether it still stood at its last reading.")]
    cause: Annotated[StopCause, Field(description="What its first reading shows.")]


class ReportedDraw(TypedDict):
    """The draw in percent while both the unit and the unit before it were at speed."""

    average: Annotated[float, Field(description="Of all web that passed.")]
    least: Annotated[float, Field(description="Of the minute with the least.")]
    greatest: Annotated[float, Field(description="Of the minute with the greatest.")]


class ReportedUnit(TypedDict):
    """The activity of a unit. ``running_s`` is missing for speeds that are ratios to a master."""

    bus: str
    unit: Annotated[int, Field(description="Address of the unit (#17), 1 to 255.")]
    name: str
    known_s: NotRequired[Annotated[float, Field(description="For how long there are readings.")]]
    unread_s: NotRequired[Annotated[float, Field(description="For how long there are none.")]]
    running_s: NotRequired[Annotated[float, Field(description="With an actual speed other than 0.")]]
    at_speed_s: NotRequired[
        Annotated[
            float,
            Field(
                description="Running with a setpoint above 0 while the unit reports at speed (window #12)."
            ),
        ]
    ]
    by_minute: NotRequired[
        Annotated[
            bool, Field(description="From averages of minutes: the readings are no longer kept, or many.")
        ]
    ]
    stops: NotRequired[list[ReportedStop]]
    stop_count: NotRequired[Annotated[int, Field(description="How often it stood.")]]
    stopped_s: NotRequired[Annotated[float, Field(description="How long its stops lasted.")]]
    speed_average: NotRequired[
        Annotated[float | None, Field(description="While it ran, in display units; null: it never ran.")]
    ]
    speed_greatest: NotRequired[Annotated[float | None, Field(description="As speed_average.")]]
    speed_unit: NotRequired[Annotated[str, Field(description="The measure of both, by its label.")]]
    length: Annotated[float | None, Field(description="Null where the label of the speed has no time.")]
    length_unit: Annotated[str | None, Field(description="The measure of the length; null without one.")]
    draw: Annotated[ReportedDraw | None, Field(description="To the unit before; null: there is none.")]
    alarms: Annotated[int, Field(description="How many came.")]
    commands: Annotated[
        int, Field(description="How many were sent to it, also as part of a change of several.")
    ]


class ReportedAlarm(AlarmTransition):
    """An alarm that came."""

    at_end: Annotated[AlarmStateShown, Field(description="Its state at the end of the span.")]
    again_at: NotRequired[Annotated[Instant, Field(description="When it came again within the span.")]]


class SpanReport(SignedShiftSheet):
    """The activity of the units in a span up to ``until``, and the events that people must know."""

    signed: Annotated[ShiftSignatures | None, Field(description="Where the span is a shift that was signed.")]
    units: Annotated[list[ReportedUnit], Field(description="Empty where there is no history.")]
    alarms: Annotated[list[ReportedAlarm], Field(description="That came: the first 200, oldest first.")]
    before: Annotated[
        list[ShiftAlarm],
        Field(description="Not normal as the span began, each with its last transition in the span."),
    ]


class CountsByUnit(NamedTuple):
    """The numbers of alarms and of commands, by bus and address."""

    alarms: dict[tuple[str, int], int]
    commands: dict[tuple[str, int], int]


def span_report(
    connection: StoreConnection,
    settings: Settings,
    span: Shift,
    now: UnixTime,
    scope: Scope,
    found: FoundUnits,
    most_stops: int = maxsize,
) -> dict[str, Any]:
    """Read a report from the stores, in a transaction. ``found``: the report of each unit, in floor order;
    ``most_stops``: the most stops of each unit, the newest."""
    until, signed = min(span.end, now), signed_sheet(connection, span.start)
    lasts_s = round(until - span.start, DIGITS)
    where, values = scope.conditions()
    came = connection.execute(
        f"SELECT {_AT_END}, {_AGAIN}, {_COLUMNS} {RISEN}{where} ORDER BY at, id LIMIT ?",
        (until, until, span.start, until, *values, _MAX_ALARMS),
    )
    earlier = [
        each for each in alarms_before(connection, span.start, until) if scope.holds(each.bus, each.unit)
    ]
    counts = CountsByUnit(*(_counts(connection, what, span.start, until) for what in (RISEN, _COMMANDS)))
    sheet = write_sheet(connection, settings, span, now, scope)
    return {
        **sheet,
        "line": line_figures(found, count_alarms(connection, Shift(span.start, until), scope), lasts_s),
        "notes": sheet["notes"][-MAX_OF_SPAN:],
        "signed": signed_json(signed if signed and signed.shift == span and not scope.bus else None),
        "units": [_unit(bus, each, counts, lasts_s, most_stops) for bus, each in found],
        "alarms": [_alarm(*row) for row in came],
        "before": [alarm_json(each) for each in earlier],
    }


def _alarm(at_end: AlarmState, again_at: UnixTime | None, *entry: Any) -> ReportedAlarm:
    shown = cast(ReportedAlarm, {**transition_json(JournalEntry(*entry)), "at_end": at_end})
    if again_at is not None:
        shown["again_at"] = iso(again_at)
    return shown


def _counts(
    connection: StoreConnection, what: str, start: UnixTime, until: UnixTime
) -> dict[tuple[str, int], int]:
    rows = connection.execute(
        f"SELECT bus, unit, count(*) {what} AND unit IS NOT NULL GROUP BY bus, unit", (start, until)
    )
    return {(bus, unit): times for bus, unit, times in rows}


def _unit(
    bus: BusSettings, found: UnitReport, counts: CountsByUnit, lasts_s: float, most_stops: int
) -> ReportedUnit:
    unit = next(each for each in bus.unit if each.id == found.unit)
    place = bus.name, unit.id
    shown: ReportedUnit = {
        "bus": bus.name,
        "unit": unit.id,
        "name": unit.name,
        "length": None,
        "length_unit": None,
        "draw": found.draw and _draw_shown(found.draw),
        "alarms": counts.alarms.get(place, 0),
        "commands": counts.commands.get(place, 0),
    }
    if found.runs is not None:
        _add_runs(shown, found.runs, unit, lasts_s, most_stops)
    return shown


def _draw_shown(draw: DrawFigures) -> ReportedDraw:
    average, least, greatest = (round(each, DIGITS) for each in draw)
    return {"average": average, "least": least, "greatest": greatest}


def _add_runs(
    shown: ReportedUnit, figures: RunFigures, unit: UnitSettings, lasts_s: float, most_stops: int
) -> None:
    ran, stopped = figures.running, sum(stop.until - stop.at for stop in figures.stops)
    shown["known_s"] = figures.known / SECOND
    shown["unread_s"] = round(max(0.0, lasts_s - figures.known / SECOND), DIGITS)
    shown["running_s"] = ran / SECOND
    shown["at_speed_s"] = figures.at_speed / SECOND
    shown["by_minute"] = figures.by_minute
    shown["speed_average"] = round(figures.travel / ran, DIGITS) if ran else None
    shown["speed_greatest"] = figures.fastest if ran else None
    shown["speed_unit"] = unit.labels.unit
    shown["stops"] = [
        {
            "start": iso(UnixTime(stop.at / SECOND)),
            "end": iso(UnixTime(stop.until / SECOND)),
            "seconds": (stop.until - stop.at) / SECOND,
            "cause": stop.cause,
            "before": figures.began_stopped and stop is figures.stops[0],
            "goes_on": figures.ended_stopped and stop is figures.stops[-1],
        }
        for stop in figures.stops[-most_stops:]
    ]
    shown["stop_count"] = len(figures.stops)
    shown["stopped_s"] = round(stopped / SECOND, DIGITS)
    shown["length"], shown["length_unit"] = length_of(figures, unit)
