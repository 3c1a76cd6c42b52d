"""The abnormal conditions of the line, the worst first. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from app.line.conditions.of_bus import NO_UNIT_RESPONDS, NO_UNIT_YET
from app.line.conditions.of_unit import (
    BLOCKED,
    DRAW_OUT_OF_BAND,
    PARAMETER_DRIFT,
    VALUE_IMPLAUSIBLE,
    implausible_of,
    suspicion,
)
from app.line.live.diagnosis.cause import Cause, Level, abnormal, unit_cause
from app.line.live.diagnosis.links import any_responds, bus_facts
from app.line.live.state.bus_live import BusLive, UnitLive
from app.line.live.state.draw import draw_of
from bus.contract import UnitLinkState
from bus.instants import UnixTime
from bus.messages import Message

_BEFORE_ALL = frozenset(
    ("worker_lost", "worker_silent", "port_lost", "unit_unknown", "unit_offline", "estop_active")
)
"""While one of these holds, nothing else about a unit matters."""


@dataclass(frozen=True, slots=True)
class UnitView:
    """The presentation of a unit. ``cause``: what its first line names; None where there is nothing."""

    unit: UnitLive
    link: UnitLinkState
    cause: Cause | None
    blocked: str = ""

    @property
    def level(self) -> Level:
        return self.cause.level if self.cause is not None else ""


_COUNTED_AS = {
    **dict.fromkeys(("ramping_up", "ramping_down"), "ramping"),
    **dict.fromkeys(("stopped", "stopping", "turning"), "off_speed"),
}


def state_counts(views: Iterable[UnitView]) -> Counter[str]:
    """How many units are in which state, and ``online``. A unit that does not respond is in no state."""
    states = Counter([view.unit.motion.state for view in views if view.link == "online"])
    counts = Counter({"online": states.total()})
    for state, count in states.items():
        counts[_COUNTED_AS.get(state, state)] += count
    return counts


def shown_cause(
    bus: BusLive,
    unit: UnitLive,
    cause: Cause | None,
    now: UnixTime,
    *,
    blocked: Message | None,
    drifted: str,
) -> Cause | None:
    """What the first line of a unit names: the first broken rung, else what else is abnormal about it.

    ``cause``: its ``unit_cause``; ``blocked``: why commands are blocked, None where they are not;
    ``drifted``: in what it departs from its golden set, empty where in nothing.
    """
    if cause is not None and cause.code in _BEFORE_ALL:
        return cause
    suspected = suspicion(bus, unit)
    others = _others(cause, _draw(bus, unit, now), implausible_of(unit), suspected, blocked, drifted)
    return next(others, cause)


def _draw(bus: BusLive, unit: UnitLive, now: UnixTime) -> Cause | None:
    """That the draw of a unit is out of its band, once it has been for as long as its alarm waits."""
    onset = unit.onsets.of.get(DRAW_OUT_OF_BAND.code)
    if onset is None or now - onset.at < DRAW_OUT_OF_BAND.tuning.on_delay_s:
        return None
    if not DRAW_OUT_OF_BAND.holds(draw_of(bus, unit, now)):
        return None
    return abnormal(DRAW_OUT_OF_BAND.code, onset)


def _others(
    cause: Cause | None,
    draw: Cause | None,
    implausible: Message | None,
    suspected: Message | None,
    blocked: Message | None,
    drifted: str,
) -> Iterator[Cause]:
    if suspected is not None:
        yield abnormal("address_suspect", params={"why": suspected})
    if cause is not None and cause.level:
        yield cause
    if implausible is not None:
        yield abnormal(VALUE_IMPLAUSIBLE.code)
    if draw is not None:
        yield draw
    if BLOCKED.holds(blocked):
        yield abnormal("blocked", params={"why": blocked})
    if PARAMETER_DRIFT.holds(drifted):
        yield abnormal("drift", params={"why": drifted})


def all_offline(bus: BusLive, now: UnixTime) -> Cause | None:
    """That no unit of a bus responds: one cause for all of them, since the last of them was lost."""
    if any_responds(bus, now):
        return None
    facts = bus_facts(bus, now)
    if NO_UNIT_YET.holds(facts):
        return abnormal("no_unit_yet")
    if not NO_UNIT_RESPONDS.holds(facts):
        return None
    causes = (unit_cause(bus, unit, now) for unit in bus.units.values())
    lost = (cause.onset for cause in causes if cause is not None and cause.onset is not None)
    return abnormal("no_unit_responds", max(lost, key=lambda onset: onset.at))
