"""An alarm of the site over stored readings, judged by the rules that judge those of the present. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from msgspec.structs import replace

from app.alarm_settings import AlarmSettings
from app.alarms.own import OwnCondition, known_decimals, own_definition
from app.alarms.rules import changes
from app.alarms.rules.changes import Changed
from app.alarms.rules.facts import AlarmFacts
from app.alarms.rules.limits import ChangeRate
from app.alarms.rules.suppression import Suppressors
from app.alarms.simulation.minute import extremes
from app.alarms.simulation.outcome import Annunciations
from app.alarms.simulation.rest import AtRest
from app.conditions.of_unit import ESTOP_ACTIVE
from app.history.series.rollup import Rollup
from app.history.series.runs import MINUTE, SECOND, Run, micros
from app.history.series.scaling import ParameterStep
from app.live.diagnosis.links import unit_facts
from app.live.state.bus_live import never_seen
from app.live.state.scan_time import scan_s_of, stale_after_s
from bus.contract import ParameterValue, Reading
from bus.instants import UnixTime
from bus.settings import BusSettings

_BEFORE = 1e-6
USUAL_SHARE = 0.9
"""With a smaller share of the readings of the minute before, some are missing."""


class Replay:
    """Feed it minutes in order of time. What they have before ``start`` or after ``end`` is left out.
    ``steps``: the values of parameters that scale."""

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
        self.is_exact = True
        self._settings = settings
        self._live = never_seen(bus, UnixTime(0.0))
        self._unit = self._live.units[settings.unit]
        self._definition = own_definition(settings)
        self._condition = OwnCondition(settings)
        self._sides = [OwnCondition(each) for each in _sides_of(settings)]
        self._stale_s = stale_after_s(scan_s_of(self._live))
        self._facts = AlarmFacts()
        self._holds: bool | None = None
        self._start, self._end = micros(start), micros(end)
        self._unknown_since: UnixTime | None = UnixTime(self._start / SECOND)
        self._read_at: UnixTime | None = None
        self._at_rest = self._estop = False
        self._readings = 0
        self._former: tuple[Reading, Reading] | None = None
        self._steps = sorted(steps)
        self._next_step = 0
        for step in reversed(self._steps):
            self._set_parameter(step)

    # --- a minute --------------------------------------------------------------------------------------

    def passes(self, row: Rollup, following: Rollup | None) -> bool:
        """Take in a minute in which nothing can have happened; False: it has to be seen in detail. So
        has the one before a change, where a rate is judged, and one with fewer readings than before."""
        self._set_parameters(row.start)
        least, greatest = ends = extremes(self._settings.unit, self._settings.value, row)
        former, self._former = self._former, ends
        fewer, self._readings = row.readings < USUAL_SHARE * self._readings, row.readings
        active, pending = self._facts.active, self._facts.changing_since is not None
        rests = self._definition.group == "speed" and (self._at_rest or not row.commanded_max)
        if fewer or pending or self._is_gap(least.at) or self._holds is not active or (active and rests):
            return False
        if active:
            estops = {self._has_estop(least), self._has_estop(greatest)}
            if estops != {self._estop} or not self._always(ends):
                return False
        elif self._may(ends, former) is not False or not self._stays(ends, following):
            return False
        self._cover(row)
        return True

    def see_run(self, run: Run, at_rest: AtRest) -> None:
        """Equal readings; for a rate of change also the one after the shortest time for a rate."""
        begins, ends = max(run.at, self._start), min(run.until, self._end)
        if begins > ends:
            return
        self._set_parameters(begins)
        times = [begins, ends]
        if self._settings.change_per_s is not None:
            times.insert(1, min(ends, begins + round(ChangeRate.SPAN_S * SECOND)))
        for at in dict.fromkeys(times):
            reading = _reading(self._settings.unit, run, at)
            # The readings in between were received, too: there is no gap in a run.
            inside = at != begins
            self._see(reading, self._rests(at, run.commanded, at_rest), inside=inside)

    def see_minute(self, row: Rollup, at_rest: AtRest) -> None:
        """A minute whose readings are not stored: what is certain, and that at the least."""
        self._set_parameters(row.start)
        ends = least, greatest = extremes(self._settings.unit, self._settings.value, row)
        begins = UnixTime(max(row.start, self._start) / SECOND)
        ends_at = UnixTime(min(row.start + MINUTE, self._end) / SECOND)
        self._pass_gap(begins)
        estops = {self._has_estop(least), self._has_estop(greatest)}
        rests = self._rests(row.start, row.commanded_max, at_rest)
        may_rest = self._definition.group == "speed" and not row.commanded_min
        hidden = rests or estops == {True}
        if hidden:
            self._estop = True in estops
            self._see_rest(begins, rests)
        may_be_hidden = not hidden and (may_rest or True in estops)
        self._observe(self._least(ends, may_be_hidden=may_be_hidden), begins)
        if not hidden and not may_be_hidden:
            self._estop = False
            self._see_rest(begins, at_rest=False)
        self._cover(row)
        self._apply(changes.advance(self._facts, self._definition.attributes, ends_at))

    def _least(self, ends: tuple[Reading, Reading], *, may_be_hidden: bool) -> bool | None:
        """Whether the condition holds in a minute, so that the alarm comes no oftener than is certain."""
        may = self._may(ends, None)
        if not may:
            return may
        if self._always(ends) and not may_be_hidden:
            return True
        self.is_exact = False
        began = self._settings.change_per_s is None and not self._definition.attributes.on_delay_s
        return self._facts.active or (began and not may_be_hidden)

    def end(self, at: UnixTime) -> None:
        """The time is over. What stands then is counted up to it."""
        self._pass_gap(at)
        self._apply(changes.advance(self._facts, self._definition.attributes, at))
        if self._unknown_since is not None:
            self.unknown_s += at - self._unknown_since

    # --- its readings ----------------------------------------------------------------------------------

    def _see(self, reading: Reading, at_rest: bool, *, inside: bool) -> None:
        if self._read_at is not None and reading.at <= self._read_at:
            return
        if not inside:
            self._pass_gap(reading.at)
        self._read_at = reading.at
        self._estop = self._has_estop(reading)
        self._hide(reading.at)
        self._observe(self._judge(self._condition, reading, self._facts.active), reading.at)
        self._see_rest(reading.at, at_rest)

    def _judge(self, condition: OwnCondition, reading: Reading, active: bool) -> bool | None:
        decimals = known_decimals(self._live, self._unit)
        return condition.holds(self._live, self._unit, reading, decimals, active)

    def _rests(self, at: int, commanded: int, at_rest: AtRest) -> bool:
        return self._definition.group == "speed" and commanded == 0 and at_rest(at)

    def _has_estop(self, reading: Reading) -> bool:
        return ESTOP_ACTIVE.holds(unit_facts(self._live, self._unit, reading))

    def _is_gap(self, at: UnixTime) -> bool:
        return self._read_at is None or at - self._read_at > self._stale_s

    def _pass_gap(self, at: UnixTime) -> None:
        if self._is_gap(at) and self._read_at is not None:
            self._condition.forget()
            self._observe(None, self._read_at + self._stale_s)

    def _cover(self, row: Rollup) -> None:
        """Readings to the end of the minute are accounted for."""
        self._read_at = UnixTime((row.start + MINUTE) / SECOND - _BEFORE)
        self._condition.forget()

    # --- what the extremes of a minute allow -------------------------------------------------------------

    def _may(self, ends: tuple[Reading, Reading], former: tuple[Reading, Reading] | None) -> bool | None:
        """Whether the condition can have begun in a minute. Where neither extreme passes a limit, nothing
        between them does."""
        if self._settings.change_per_s is not None:
            return self._may_change(ends, former)
        found = [self._judge(self._condition, each, self._facts.active) for each in ends]
        return None if None in found else any(found)

    def _stays(self, ends: tuple[Reading, Reading], following: Rollup | None) -> bool:
        if self._settings.change_per_s is None:
            return True
        if following is None:
            return False
        after = extremes(self._settings.unit, self._settings.value, following)
        return self._may_change(after, ends) is False

    def _may_change(
        self, ends: tuple[Reading, Reading], former: tuple[Reading, Reading] | None
    ) -> bool | None:
        """A rate is at most the reach of this minute and the former one, in the shortest time for a rate."""
        rate = OwnCondition(self._settings)
        parts = [*ends, *(former or ends)]
        found = []
        for low in parts:
            for high in parts:
                rate.forget()
                self._judge(rate, replace(low, at=UnixTime(0.0)), active=False)
                found.append(self._judge(rate, replace(high, at=UnixTime(ChangeRate.SPAN_S)), active=False))
        return None if None in found else any(found)

    def _always(self, ends: tuple[Reading, Reading]) -> bool:
        """Whether it held in every reading of a minute: both extremes are beyond the same limit."""
        if self._settings.change_per_s is not None:
            return False
        return any(all(self._judge(side, each, self._facts.active) for each in ends) for side in self._sides)

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
            self._apply(changes.suppress(self._facts, self._definition.attributes, True, at))
        self._apply(changes.observe(self._facts, self._definition.attributes, holds, at))

    def _see_rest(self, at: UnixTime, at_rest: bool) -> None:
        """The engine sees an e-stop with the reading that shows it, and a line at rest after that."""
        self._at_rest = at_rest
        self._hide(at)

    def _hide(self, at: UnixTime) -> None:
        """An alarm that is neither active nor about to be is left alone."""
        facts = self._facts
        if facts.suppressed or facts.active or self._holds:
            self._apply(changes.suppress(facts, self._definition.attributes, self._suppresses(), at))

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


def _sides_of(settings: AlarmSettings) -> Iterable[AlarmSettings]:
    """A rule with one limit for each of its limits."""
    if settings.above is None or settings.below is None:
        return [settings]
    return [settings.model_copy(update={side: None}) for side in ("above", "below")]


def _reading(unit: int, run: Run, at: int) -> Reading:
    time = UnixTime(at / SECOND)
    return Reading(unit, time, run.commanded, run.actual, run.analog, run.word >> 8, run.word & 0xFF)
