"""The simulation of an alarm of the site over stored readings, by the rules that judge the present: one at a
time, each within its bounds, in pieces that leave time for everything else."""

from __future__ import annotations

import asyncio
import time
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Annotated

from pydantic import Field

from app.core.server.turns import FairQueue
from app.core.web.shape import InstantObject
from app.line.alarms import rules
from app.line.alarms.own_condition import OwnCondition, in_toml, known_decimals, own_definition
from app.line.alarms.performance import CHATTERS_S
from app.line.alarms.rules import AlarmFacts, Changed, ChangeRate, Suppressors, Transition
from app.line.alarms.settings import AlarmSettings
from app.line.conditions.unit import ESTOP_ACTIVE
from app.line.history import query, tables
from app.line.history.query import StoredUnit, minutes_of
from app.line.history.recorder import Tail
from app.line.history.series.runs import HOUR, MINUTE, SECOND, Rollup, Run, micros
from app.line.history.series.values import VALUES, ParameterStep
from app.line.history.service import History
from app.line.live.bus_live import bus_without_reports, scan_s_of, stale_after_s
from app.line.live.diagnosis import unit_facts
from bus.contract import ParameterValue, Reading
from bus.instants import UnixTime
from bus.settings import BusSettings

CHATTERING_TIMES = 3
SimulatedTime = Annotated[InstantObject | None, Field(description="ISO 8601 in UTC; null: there is none.")]


@dataclass(slots=True)
class Annunciations:
    """The times at which an alarm would have been annunciated, and for how long each time."""

    at: list[UnixTime] = field(default_factory=list)
    lengths: list[float] = field(default_factory=list)
    """The seconds for which it was active and not hidden, each time."""
    stands_since: UnixTime | None = None

    def see(self, transitions: Sequence[Transition]) -> None:
        """Add transitions of the alarm."""
        for each in transitions:
            stands = each.after == "unack_active"
            if stands and self.stands_since is None:
                self.at.append(each.at)
                self.stands_since = each.at
            elif not stands:
                self.end(each.at)

    def end(self, at: UnixTime) -> None:
        """End the present annunciation: the alarm cleared or was hidden, or the simulation ends."""
        if self.stands_since is not None:
            self.lengths.append(at - self.stands_since)
            self.stands_since = None

    @property
    def chattering(self) -> int:
        """The number of annunciations that are among three within a minute."""
        among: set[int] = set()
        last = CHATTERING_TIMES - 1
        for index in range(last, len(self.at)):
            if self.at[index] - self.at[index - last] <= CHATTERS_S:
                among.update(range(index - last, index + 1))
        return len(among)


@dataclass(frozen=True, slots=True)
class AlarmSimulation:
    """The result of a simulation. Durations in seconds."""

    start: Annotated[InstantObject, Field(serialization_alias="from")]
    end: Annotated[InstantObject, Field(serialization_alias="to")]
    covered_from: Annotated[
        InstantObject | None,
        Field(description="From when on readings are stored; null: none of this time are."),
    ]
    covered_to: SimulatedTime
    annunciated: Annotated[int, Field(description="How often it would have come.")]
    chattering: Annotated[int, Field(description="How many of them were among three within a minute.")]
    first: SimulatedTime
    last: SimulatedTime
    standing_s: Annotated[float, Field(description="Active and not suppressed, in total.")]
    longest_s: Annotated[float | None, Field(description="The longest time; null: it did not come.")]
    stands_at_end: bool
    unknown_s: Annotated[float, Field(description="About; of the covered time: no readings, or no scale.")]
    complete: Annotated[bool, Field(description="false: the work was ended at covered_to.")]
    toml: Annotated[str, Field(description="The entry for lineside.toml.")]


ZeroStep = tuple[int, bool]
"""The time (µs) from which on zero, or another speed, was commanded to a unit."""
AtRest = Callable[[int], bool]


def _line_at_rest(units: Sequence[Sequence[ZeroStep]]) -> AtRest:
    """Return a function that returns whether the line was at rest at a time, by the steps of each unit in
    order. A unit without steps is no proof of rest; before its first step a unit was as after it."""
    if not units or not all(units):
        return lambda _: False
    states = [steps[0][1] for steps in units]
    times, found = [0], [all(states)]
    for at, unit, is_zero in sorted(
        (at, unit, zero) for unit, steps in enumerate(units) for at, zero in steps
    ):
        states[unit] = is_zero
        if all(states) != found[-1]:
            times.append(at)
            found.append(not found[-1])
    return lambda at: found[bisect_right(times, at) - 1]


_BEFORE = 1e-6
USUAL_SHARE = 0.9
"""The share of the readings of the minute before below which some are missing."""


class Replay:
    """The replay of stored minutes, fed in order of time. Parts before ``start`` or after ``end`` are left
    out. ``steps``: the values of parameters that scale."""

    def __init__(
        self,
        bus: BusSettings,
        settings: AlarmSettings,
        steps: Sequence[ParameterStep],
        start: UnixTime,
        end: UnixTime,
    ) -> None:
        self.found = Annunciations()
        self.unknown_s = 0.0
        self._settings = settings
        self._live = bus_without_reports(bus, UnixTime(0.0))
        self._unit = self._live.units[settings.unit]
        self._definition = own_definition(settings)
        self._condition = OwnCondition(settings)
        self._stale_s = stale_after_s(scan_s_of(self._live))
        self._facts = AlarmFacts()
        self._holds: bool | None = None
        self._start, self._end = micros(start), micros(end)
        self._unknown_since: UnixTime | None = UnixTime(self._start / SECOND)
        self._read_at: UnixTime | None = None
        self._at_rest = self._estop = False
        self._readings = 0
        self._steps = sorted(steps)
        self._next_step = 0
        for step in reversed(self._steps):
            self._set_parameter(step)

    def passes(self, row: Rollup) -> bool:
        """Pass a minute in which the alarm cannot have begun: no reading is missing, and neither extreme
        fulfills the condition. Return False if the readings of the minute have to be judged."""
        self._set_parameters(row.start)
        fewer, self._readings = row.readings < USUAL_SHARE * self._readings, row.readings
        is_quiet = self._holds is False and not self._facts.active and self._facts.changing_since is None
        if fewer or not is_quiet or self._settings.change_per_s is not None:
            return False
        ends = extremes(self._settings.unit, self._settings.value, row)
        if self._is_gap(ends[0].at) or any(self._judge(each) is not False for each in ends):
            return False
        self._read_at = UnixTime((row.start + MINUTE) / SECOND - _BEFORE)
        return True

    def judge_run(self, run: Run, at_rest: AtRest) -> None:
        """Judge a run of equal readings: the first and the last, and for a rate of change the one after the
        shortest time for a rate."""
        begins, ends = max(run.at, self._start), min(run.until, self._end)
        if begins > ends:
            return
        self._set_parameters(begins)
        times = [begins, ends]
        if self._settings.change_per_s is not None:
            times.insert(1, min(ends, begins + round(ChangeRate.SPAN_S * SECOND)))
        for at in dict.fromkeys(times):
            rests = self._definition.group == "speed" and run.commanded == 0 and at_rest(at)
            # The readings in between were received too: there is no gap in a run.
            self._see(_reading(self._settings.unit, run, at), rests, inside=at != begins)

    def end(self, at: UnixTime) -> None:
        """End the simulation at a time, up to which an annunciation that stands is counted."""
        self._pass_gap(at)
        self._apply(rules.advance(self._facts, self._definition.attributes, at))
        if self._unknown_since is not None:
            self.unknown_s += at - self._unknown_since

    # --- its readings ----------------------------------------------------------------------------------

    def _see(self, reading: Reading, at_rest: bool, *, inside: bool) -> None:
        if self._read_at is not None and reading.at <= self._read_at:
            return
        if not inside:
            self._pass_gap(reading.at)
        self._read_at = reading.at
        self._estop = ESTOP_ACTIVE.holds(unit_facts(self._live, self._unit, reading))
        self._hide(reading.at)
        self._observe(self._judge(reading), reading.at)
        # The engine sees an e-stop with the reading that shows it, but a line at rest only afterwards.
        self._at_rest = at_rest
        self._hide(reading.at)

    def _judge(self, reading: Reading) -> bool | None:
        decimals = known_decimals(self._live, self._unit)
        return self._condition.holds(self._live, self._unit, reading, decimals, self._facts.active)

    def _is_gap(self, at: UnixTime) -> bool:
        return self._read_at is None or at - self._read_at > self._stale_s

    def _pass_gap(self, at: UnixTime) -> None:
        if self._is_gap(at) and self._read_at is not None:
            self._condition.forget()
            self._observe(None, self._read_at + self._stale_s)

    # --- the rules ---------------------------------------------------------------------------------------

    def _observe(self, holds: bool | None, at: UnixTime) -> None:
        if self._unknown_since is not None and holds is not None:
            self.unknown_s += at - self._unknown_since
            self._unknown_since = None
        elif self._unknown_since is None and holds is None:
            self._unknown_since = at
        if holds is self._holds and self._facts.changing_since is None:
            return
        rises, self._holds = bool(holds) and not self._holds, holds
        if rises and self._suppresses():
            self._apply(rules.suppress(self._facts, True, at))
        self._apply(rules.observe(self._facts, self._definition.attributes, holds, at))

    def _hide(self, at: UnixTime) -> None:
        """Begin or end the suppression of the alarm, unless it is neither active nor about to be."""
        facts = self._facts
        if facts.suppressed or facts.active or self._holds:
            self._apply(rules.suppress(facts, self._suppresses(), at))

    def _suppresses(self) -> bool:
        unit = self._settings.unit
        suppressors = Suppressors(at_rest=self._at_rest, estops={unit} if self._estop else ())
        return suppressors.suppress(self._definition.group, unit)

    def _apply(self, changed: Changed) -> None:
        self._facts, transitions = changed
        self.found.see(transitions)

    # --- parameters ----------------------------------------------------------------------------------------

    def _set_parameters(self, at: int) -> None:
        while self._next_step < len(self._steps) and self._steps[self._next_step].at <= at:
            self._set_parameter(self._steps[self._next_step])
            self._next_step += 1

    def _set_parameter(self, step: ParameterStep) -> None:
        value = ParameterValue(self._settings.unit, step.number, UnixTime(step.at / SECOND), step.raw)
        self._unit.parameters[step.number] = value


def _reading(unit: int, run: Run, at: int) -> Reading:
    time = UnixTime(at / SECOND)
    return Reading(unit, time, run.commanded, run.actual, run.analog, run.word >> 8, run.word & 0xFF)


def extremes(unit: int, value: str, row: Rollup) -> tuple[Reading, Reading]:
    """Return two readings with the least and the greatest that ``value`` can have been in a minute; for a
    bit: with the bits that were on in every reading, and in any. Neither reading needs to have been sent."""
    speeds = (row.commanded_min, row.actual_min), (row.commanded_max, row.actual_max)
    if value == "deviation":
        # If the two ranges overlap, the speeds may have been equal.
        common = max(row.commanded_min, row.actual_min)
        apart = (row.commanded_min, row.actual_max), (row.commanded_max, row.actual_min)
        least = common, min(common, row.commanded_max, row.actual_max)
        speeds = least, max(apart, key=lambda pair: abs(pair[0] - pair[1]))
    at = UnixTime(row.start / SECOND)
    rest = ((row.analog_min, row.word_and), (row.analog_max, row.word_or))
    first, last = (
        Reading(unit, at, *speed, analog, word >> 8, word & 0xFF)
        for speed, (analog, word) in zip(speeds, rest, strict=True)
    )
    return first, last


MAX_WAITING = 3
"""The most simulations of one account that wait for their turn."""
WORK_S = 10.0
"""The seconds of CPU time that one simulation may take."""


class Simulator:
    """The simulation of alarms of all buses."""

    def __init__(self, history: History, work_s: float = WORK_S) -> None:
        self._history = history
        self._work_s = work_s
        self._turns: FairQueue[str] = FairQueue(1, 1, MAX_WAITING)

    async def run(
        self, bus: BusSettings, settings: AlarmSettings, start: UnixTime, end: UnixTime, account: str
    ) -> AlarmSimulation:
        """Return what an alarm would have done from ``start`` to ``end``. Raise StoreError if history cannot
        be read, TooManyWaitingError if too many simulations of the account wait."""
        async with self._turns.turn(account):
            return await self._run(bus, settings, start, end)

    async def _run(
        self, bus: BusSettings, settings: AlarmSettings, start: UnixTime, end: UnixTime
    ) -> AlarmSimulation:
        begins, steps = await self._history.read(
            lambda connection, tail: _extent(connection, tail, bus.name, settings.unit), costly=True
        )
        if begins is None or begins >= micros(end):
            return _outcome(settings, (start, end), Annunciations())
        since = max(micros(start), begins)
        covered_from = UnixTime(since / SECOND)
        since -= since % MINUTE
        replay, spent = Replay(bus, settings, steps, covered_from, end), 0.0
        while since < micros(end) and spent < self._work_s:
            until = min(since - since % HOUR + HOUR, micros(end) + MINUTE - micros(end) % MINUTE)
            took = await self._history.read(
                lambda connection, tail, a=since, b=until: _feed(  # type: ignore[misc]
                    StoredHour(connection, tail, bus, a, b), replay, settings
                ),
                costly=True,
            )
            spent += took
            # The pause is as long as the work, so that the work of others comes first.
            await asyncio.sleep(took)
            since = until
        reached = max(covered_from, UnixTime(min(since, micros(end)) / SECOND))
        replay.end(reached)
        covered, is_complete = (covered_from, reached), micros(reached) >= micros(end)
        return _outcome(settings, (start, end), replay.found, covered, replay.unknown_s, is_complete)


def _extent(
    connection: tables.StoreConnection, tail: Tail, bus: str, unit: int
) -> tuple[int | None, Sequence[ParameterStep]]:
    """Return when the stored readings of a unit begin (µs; None: no readings), and its parameters that
    scale."""
    key = tables.find_unit(connection, bus, unit)
    if key is None:
        return None, ()
    source = StoredUnit(connection, key, tail.runs(key, 0, 2**62)[:1])
    starts = [run.at for run in source.tail]
    first = tables.first_minute(connection, key)
    if first is not None:
        starts += [min((row.start for row in minutes_of(source, first, first + HOUR)), default=first)]
    begins = max(min(starts), tables.raw_from(connection)) if starts else None
    return begins, tables.parameter_steps(connection, key)


def _feed(hour: StoredHour, replay: Replay, settings: AlarmSettings) -> float:
    """Feed an hour to a simulation, and return the CPU seconds of this thread that it took."""
    begun = time.thread_time()
    hour.feed(replay, settings)
    return time.thread_time() - begun


def _outcome(
    settings: AlarmSettings,
    span: tuple[UnixTime, UnixTime],
    found: Annunciations,
    covered: tuple[UnixTime | None, UnixTime | None] = (None, None),
    unknown_s: float = 0.0,
    is_complete: bool = True,
) -> AlarmSimulation:
    stands_at_end = found.stands_since is not None
    if covered[1] is not None:
        found.end(covered[1])
    return AlarmSimulation(
        *span,
        *covered,
        annunciated=len(found.at),
        chattering=found.chattering,
        first=found.at[0] if found.at else None,
        last=found.at[-1] if found.at else None,
        standing_s=round(sum(found.lengths), 3),
        longest_s=round(max(found.lengths), 3) if found.lengths else None,
        stands_at_end=stands_at_end,
        unknown_s=round(unknown_s, 3),
        complete=is_complete,
        toml=in_toml(settings),
    )


class StoredHour:
    """An hour of a unit from the store, read on one connection. ``start`` and ``end``: complete minutes,
    µs."""

    def __init__(
        self, connection: tables.StoreConnection, tail: Tail, bus: BusSettings, start: int, end: int
    ) -> None:
        self._connection = connection
        self._tail = tail
        self._bus = bus
        self._start, self._end = start, end
        self._rest: AtRest | None = None
        self._runs: dict[int, list[Run]] | None = None

    def feed(self, replay: Replay, settings: AlarmSettings) -> None:
        """Feed every stored minute to ``replay``."""
        source = self._source(settings.unit)
        if source is None:
            return
        rows = {row.start: row for row in minutes_of(source, self._start, self._end)}
        for minute in range(self._start, self._end, MINUTE):
            if minute in rows and replay.passes(rows[minute]):
                continue
            for run in self._runs_of(source).get(minute, ()):
                replay.judge_run(run, self._is_at_rest)

    def _source(self, unit: int) -> StoredUnit | None:
        span = (self._start, self._end)
        return query.stored_unit(self._connection, self._tail, self._bus.name, unit, *span)

    def _runs_of(self, source: StoredUnit) -> dict[int, list[Run]]:
        if self._runs is None:
            found = query.runs_between(source, self._start, self._end)
            self._runs = {
                minute: list(runs) for minute, runs in groupby(found, lambda run: run.at - run.at % MINUTE)
            }
        return self._runs

    def _is_at_rest(self, at: int) -> bool:
        if self._rest is None:
            self._rest = _line_at_rest([self._zero_steps(unit.id) for unit in self._bus.unit])
        return self._rest(at)

    def _zero_steps(self, unit: int) -> list[ZeroStep]:
        """Return the steps of a unit, from minutes if none had both zero and another commanded speed."""
        source = self._source(unit)
        if source is None:
            return []
        rows = list(minutes_of(source, self._start, self._end))
        is_mixed = any(row.commanded_min == 0 < row.commanded_max for row in rows)
        if not source.tail and not is_mixed:
            return [(row.start, row.commanded_max == 0) for row in rows]
        found = query.readings(source, VALUES["commanded"], self._start, self._end)
        return [(at, value == 0) for at, value in zip(found.at, found.least, strict=True)]
