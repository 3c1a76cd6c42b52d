"""Figures of a line in a shift or any other span: the number and duration of its stops, the number of its
alarms, the length of its web."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from typing import Annotated, NamedTuple, NotRequired

import structlog
from pydantic import Field
from typing_extensions import TypedDict

from app.core.database import Database, StoreConnection
from app.core.web.formats import lasting, length_shown
from app.errors import StoreError
from app.line.history.report import MAX_REPORT_READINGS, BusReport, UnitReport
from app.line.history.series.figures import RunFigures
from app.line.history.series.runs import SECOND, micros
from app.line.history.series.values import united
from app.line.history.service import History
from app.records.handover.rules import EVERYTHING, Scope, Shift
from app.settings import Settings
from bus.instants import Clock, UnixTime, unix_now
from bus.messages import Message, number
from bus.settings import BusSettings, UnitSettings

PER_S = {"s": 1, "sec": 1, "min": 60, "h": 3600}
"""The seconds in the time of a unit of speed, such as m/min."""
DIGITS = 3
RISEN = "FROM alarm_journal j WHERE trigger = 'rise' AND at >= ? AND at < ?"
"""SQL that selects the alarms that came in a span."""
LATE_S, PRESENT_S = 3600.0, 30.0
"""The time after the end of a shift within which its readings may come; until then the list of shifts reads
its figures again every half minute, and its sheet each time."""
UNREAD_SHOWN_S = 60.0
"""The least time without readings that a summary says: less is the lag of the newest readings."""
REMEMBERED = 100
"""The shifts whose figures are remembered."""
log = structlog.get_logger()
FoundUnits = Sequence[tuple[BusSettings, UnitReport]]
"""The report of each unit, with its bus, in floor order."""


class LineFigures(TypedDict):
    """The figures of the line in a span."""

    stops: Annotated[int | None, Field(description="Times in which any unit stood; null: no unit was read.")]
    stopped_s: Annotated[float | None, Field(description="How long those lasted; null: no unit was read.")]
    alarms: Annotated[int, Field(description="How many came.")]
    length: Annotated[
        float | None, Field(description="Of the web at the last unit; null where its speed has no length.")
    ]
    length_unit: Annotated[str | None, Field(description="The measure of the length; null without one.")]
    unread_s: NotRequired[
        Annotated[
            float | None,
            Field(
                description="How long the unit of the length was not read, or without a length the unit read "
                "most; null: no unit was read; absent from sheets that an earlier version signed."
            ),
        ]
    ]


class Length(NamedTuple):
    """The length of web that passed a unit, in the measure of its label; None and None without a measure."""

    length: float | None = None
    measure: str | None = None


def length_of(figures: RunFigures, unit: UnitSettings) -> Length:
    """Return the length of the web that passed a unit."""
    if (found := length_measure(unit)) is None:
        return Length()
    measure, per_s = found
    return Length(round(figures.travel / SECOND / per_s, DIGITS), measure)


def length_measure(unit: UnitSettings) -> tuple[str, int] | None:
    """Return the unit of length in a unit of speed such as m/min, and the seconds of its unit of time; None
    for a unit of speed without them."""
    measure, _, per = unit.labels.unit.strip().partition("/")
    return (measure.strip(), PER_S[per.strip()]) if measure and per.strip() in PER_S else None


def line_figures(found: FoundUnits, alarms: int, lasts_s: float) -> LineFigures:
    """Return the figures of a line in a span of so many seconds. Units that stand at the same time count as
    one stop."""
    read = [(bus, each.unit, each.runs) for bus, each in found if each.runs is not None and each.runs.known]
    standing = united((stop.at, stop.until) for _, _, runs in read for stop in runs.stops)
    length = Length()
    known = max((runs.known for _, _, runs in read), default=0)
    if read and len({bus.name for bus, _, _ in read}) == 1:
        bus, last, runs = read[-1]
        length = length_of(runs, next(unit for unit in bus.unit if unit.id == last))
        known = runs.known if length.measure else known
    return {
        "stops": len(standing) if read else None,
        "stopped_s": sum(until - at for at, until in standing) / SECOND if read else None,
        "alarms": alarms,
        "length": length.length,
        "length_unit": length.measure,
        "unread_s": round(max(0.0, lasts_s - known / SECOND), DIGITS) if read else None,
    }


def line_summary(line: LineFigures | None) -> Iterator[Message]:
    """Yield what a line did, in a few words, the same on the list of shifts, a sheet and a report; None: the
    history cannot be read."""
    if line is None or line["stops"] is None:
        yield Message("figures_none")
    elif not line["stops"]:
        yield Message("figures_no_stops")
    else:
        yield Message.of("figures_stops", n=line["stops"], lasting=lasting(line["stopped_s"] or 0.0))
    if line is None:
        return
    yield Message.of("figures_alarms", n=line["alarms"])
    if line["length"] is not None:
        figure, measure = length_shown(line["length"], line["length_unit"] or "")
        yield Message.of("figures_length", length=number(figure), measure=measure)
    if (unread_s := line.get("unread_s") or 0.0) >= UNREAD_SHOWN_S:
        yield Message.of("figures_unread", lasting=lasting(unread_s))


def count_alarms(connection: StoreConnection, span: Shift, scope: Scope) -> int:
    """Return the number of alarms that came in a span."""
    where, values = scope.conditions()
    [count] = connection.execute(
        f"SELECT count(*) {RISEN}{where}", (span.start, span.end, *values)
    ).fetchone()
    return int(count)


class ReportedBus(NamedTuple):
    """A bus of a report, and the reader of its units."""

    settings: BusSettings
    figures: BusReport


def reported_buses(settings: Settings, scope: Scope, span: Shift, now: UnixTime) -> list[ReportedBus]:
    """Return each bus of a scope with the reader of its units."""
    buses = [bus for bus in settings.bus if scope.bus in (None, bus.name)]
    wanted = micros(span.start), micros(min(span.end, now))
    share = MAX_REPORT_READINGS // max(1, len(buses))
    return [ReportedBus(bus, BusReport(bus, scope.unit, wanted, share)) for bus in buses]


class SpanFigures:
    """The reader of the figures of units and lines from the history of the running server."""

    def __init__(
        self, settings: Settings, database: Database, history: History, clock: Clock = unix_now
    ) -> None:
        self._settings = settings
        self._database = database
        self._history = history
        self._clock = clock
        self._remembered: dict[Shift, tuple[UnixTime, LineFigures]] = {}
        self._wanted: dict[Shift, None] = {}
        self._is_wanted = asyncio.Event()
        self.unreadable: set[Shift] = set()
        """The shifts whose figures could not be read when they were last asked for."""

    async def units(self, span: Shift, scope: Scope, now: UnixTime) -> FoundUnits:
        """Return the report of each unit. Units are read one by one, so that other reads come in between.
        Raise StoreError."""
        found = []
        for bus, figures in reported_buses(self._settings, scope, span, now):
            for unit in figures.units:
                read = await self._history.read(
                    lambda connection, tail, figures=figures, unit=unit: figures.read(connection, tail, unit),  # type: ignore[misc]
                    costly=True,
                )
                found.append((bus, read))
        return found

    async def shift(self, shift: Shift) -> LineFigures:
        """Return the figures of a shift, up to now if it is under way. Raise StoreError."""
        found = self._known(shift, within_s=0.0)
        if found is None:
            now = self._clock()
            units = await self.units(shift, EVERYTHING, now)
            alarms = await self._database.read(lambda store: count_alarms(store, shift, EVERYTHING))
            found = line_figures(units, alarms, min(shift.end, now) - shift.start)
            self._remembered.pop(shift, None)
            while len(self._remembered) >= REMEMBERED:
                del self._remembered[next(iter(self._remembered))]
            self._remembered[shift] = now, found
        return found

    def known(self, shift: Shift) -> LineFigures | None:
        """Return the figures of a shift if they are remembered; if not, :meth:`follow` will read them."""
        found = self._known(shift)
        if found is None and len(self._wanted) < REMEMBERED:
            self._wanted[shift] = None
            self._is_wanted.set()
        return found

    async def follow(self) -> None:
        """Read the figures that were wanted, one shift after the other, until canceled."""
        while True:
            await self._is_wanted.wait()
            while self._wanted:
                shift = next(iter(self._wanted))
                try:
                    await self.shift(shift)
                    self.unreadable.discard(shift)
                except StoreError as error:
                    log.warning("figures of a shift not read", shift=float(shift.start), why=str(error))
                    self.unreadable.add(shift)
                del self._wanted[shift]
            self._is_wanted.clear()

    def _known(self, shift: Shift, within_s: float = PRESENT_S) -> LineFigures | None:
        """Return the figures of a shift from memory if the shift is over, or if they were read less than
        ``within_s`` seconds ago; else None."""
        read_at, figures = self._remembered.get(shift, (UnixTime(0.0), None))
        is_current = read_at > shift.end + LATE_S or self._clock() - read_at < within_s
        return figures if is_current else None
