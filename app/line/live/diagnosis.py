"""The judgment of a line: the facts about units and buses, the causes of abnormal conditions, and the
presentation of a unit. Pure.

The cause of a unit is the first broken rung of e-stop → run → mode → link → ramp: what a unit needs to be at
speed, each rung of which needs the one before.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import ceil
from typing import Any, Literal

from app.line.conditions.catalogue import NO_UNIT_RESPONDS, NO_UNIT_YET, TILES, tile_text
from app.line.conditions.condition import PRIORITIES, AlarmPriority, BusFacts, LinkFacts, UnitFacts
from app.line.conditions.unit import (
    BLOCKED,
    BY_READING,
    DRAW_OUT_OF_BAND,
    PARAMETER_DRIFT,
    UNIT_UNKNOWN,
    VALUE_IMPLAUSIBLE,
    implausible_of,
    suspicion,
)
from app.line.live.bus_live import (
    BusLive,
    Onset,
    UnitLive,
    bits_of,
    draw_of,
    is_driven,
    later,
    lost_at,
    mode_of,
    offline_after_s,
    ramp_seconds,
    scan_s_of,
    speed_decimals,
    stale_after_s,
    unit_link_now,
    worker_timed_out,
)
from bus.contract import Reading, UnitLinkState
from bus.contract.actions import POLL_BYTES
from bus.instants import UnixTime
from bus.messages import Message
from bus.settings import wire_seconds


def bus_facts(bus: BusLive, now: UnixTime) -> BusFacts:
    """Return the facts that decide the conditions of a bus."""
    patience_s = offline_after_s(scan_s_of(bus))
    lost = unread = 0
    for unit in bus.units.values():
        if lost_at(bus, unit, now, patience_s) is not None:
            lost += 1
        elif unit.reading is None:
            unread += 1
    turnaround_s = wire_seconds(POLL_BYTES, bus.baud) + bus.settings.turnaround_s
    return BusFacts(
        worker_is_lost=bus.worker_lost is not None or worker_timed_out(bus, now),
        port_is_closed=bus.link.link == "closed",
        units=len(bus.units),
        lost=lost,
        unread=unread,
        scan_s=None if bus.figures is None else bus.figures.scan_s,
        longest_scan_s=max(len(bus.units) * turnaround_s, bus.settings.least_scan_s),
    )


def any_responds(bus: BusLive, now: UnixTime) -> bool:
    """Return whether any unit of a bus responds."""
    patience_s = offline_after_s(scan_s_of(bus))
    return any(
        unit.reading is not None and lost_at(bus, unit, now, patience_s) is None
        for unit in bus.units.values()
    )


def link_facts(bus: BusLive, unit: UnitLive, now: UnixTime, *, bus_is_readable: bool) -> LinkFacts:
    """Return the facts about the link of a unit."""
    found_at = lost_at(bus, unit, now, offline_after_s(scan_s_of(bus)))
    return LinkFacts(
        bus_is_readable=bus_is_readable,
        is_lost=found_at is not None,
        is_online=unit_link_now(bus, unit, now) == "online",
        is_alone=found_at is not None and len(bus.units) > 1 and not _has_reading_after(bus, found_at),
    )


def unit_facts(bus: BusLive, unit: UnitLive, reading: Reading, *, is_late: bool = False) -> UnitFacts:
    """Return the facts about a unit by its newest reading."""
    bits = bits_of(bus, reading)
    return UnitFacts(bits, unit.motion.state, reading.commanded, reading.actual, is_late)


def _has_reading_after(bus: BusLive, at: UnixTime) -> bool:
    return bus.read_at is not None and bus.read_at > at


Level = AlarmPriority | Literal[""]
"""The priority of a cause; empty if it is not abnormal."""


def _motion(bus: BusLive, unit: UnitLive, reading: Reading) -> dict[str, str]:
    """Return how a unit moves despite a broken rung; nothing if that is unknown or as commanded."""
    state = unit.motion.state
    if is_driven(bits_of(bus, reading)):
        off_speed = "stopped" if reading.actual == 0 else "off_speed"
        return {"motion": off_speed} if state == "off_speed" else {}
    if state in ("stopped", "at_zero"):
        return {"motion": "stopped"}
    return {"motion": state} if state in ("stopping", "turning") else {}


def _mode(bus: BusLive, unit: UnitLive, reading: Reading) -> dict[str, str]:
    return {"mode": mode_of(unit, bits_of(bus, reading)).upper()}


_NAMED = {"motion": _motion, "mode": _mode}


@dataclass(frozen=True, slots=True)
class Cause:
    """A cause. ``params``: the parameters of its text; ``why`` among them is itself a text."""

    code: str
    level: Level
    onset: Onset | None = None
    params: Mapping[str, Any] = field(default_factory=dict)


def abnormal(code: str, onset: Onset | None = None, params: Mapping[str, Any] | None = None) -> Cause:
    """Return a cause with the priority of its condition. Raise KeyError for a code without one."""
    return Cause(code, TILES[code].priority, onset, params or {})


def unit_cause(bus: BusLive, unit: UnitLive, now: UnixTime) -> Cause | None:
    """Return the first broken rung of a unit; None if it is at speed or at a commanded zero, and open to
    commands.

    Nothing else is known about a unit that does not respond. If its bus is the cause, the unit names that
    without a priority: it is abnormal once, at the bus.
    """
    link, reading = unit_link_now(bus, unit, now), unit.reading
    if link != "online" and (found := connection_cause(bus, now)) is not None:
        return Cause(found.code, "", found.onset, found.params)
    if reading is None:
        return _never_read(bus, unit, now)
    if link == "offline":
        return abnormal("unit_offline", Onset(reading.at))
    # A single missed poll is shown, but is no cause yet.
    is_late = link == "stale" and now - reading.at > stale_after_s(scan_s_of(bus))
    facts = unit_facts(bus, unit, reading, is_late=is_late)
    for index, row in enumerate(BY_READING):
        if (row.broken or row.holds)(facts):
            return _broken(index, facts, bus, unit, reading)
    return _ramp(bus, unit, reading) if unit.motion.state in ("ramping_up", "ramping_down") else None


def _broken(index: int, facts: UnitFacts, bus: BusLive, unit: UnitLive, reading: Reading) -> Cause:
    """Return the rung of a row of the ladder, with the highest priority of all that hold from there on."""
    row = BY_READING[index]
    held = [each.priority for each in BY_READING[index:] if each.holds(facts)] if row.holds(facts) else []
    params = {key: text for name in row.names for key, text in _NAMED[name](bus, unit, reading).items()}
    since = row.since or ((row.code,) if row.status else ())
    onset = _since(unit, since) if since else Onset(reading.at)
    return Cause(row.code, min(held, key=PRIORITIES.index, default=""), onset, params)


def broken_rung(cause: Cause | None) -> str:
    """Return the broken rung of a ``unit_cause`` with its priority, ``run high``; the rung alone if another
    condition has the priority; empty if no rung is broken. An unreadable unit breaks the rung link."""
    if cause is None or cause.code == "ramping":
        return ""
    return f"{TILES[cause.code].rung or 'link'} {cause.level}".rstrip()


def _since(unit: UnitLive, names: Sequence[str]) -> Onset | None:
    return later(*(unit.onsets.since.get(name) for name in names))


def _ramp(bus: BusLive, unit: UnitLive, reading: Reading) -> Cause:
    target = reading.commanded
    seconds = None if target is None else ramp_seconds(unit, reading.actual, target)
    left = None if seconds is None else ceil(seconds)
    params = {
        "target_raw": target,
        "decimals": speed_decimals(bus, unit),
        "seconds_left": left,
    }
    return Cause("ramping", "", _since(unit, ("not_at_speed",)), params)


def _never_read(bus: BusLive, unit: UnitLive, now: UnixTime) -> Cause:
    """Return the cause of a unit that has not responded since the start; it counts as lost once its time is
    over."""
    is_overdue = now - bus.link_onset.at >= offline_after_s(scan_s_of(bus))
    if UNIT_UNKNOWN.holds(is_overdue):
        return abnormal("unit_unknown")
    if unit.last_response is None:
        return abnormal("unit_offline", Onset(bus.link_onset.at, exact=False))
    return abnormal("unit_offline", Onset(unit.last_response))


def connection_cause(bus: BusLive, now: UnixTime) -> Cause | None:
    """Return why a bus cannot be read, by its worker or its port; None if it can."""
    if bus.worker_lost is not None:
        return abnormal("worker_lost", bus.worker_lost)
    if bus.figures is not None and worker_timed_out(bus, now):
        return abnormal("worker_silent", Onset(bus.figures.at))
    if bus.link.link == "closed":
        return abnormal("port_lost", bus.link_onset, {"why": bus.link.cause})
    return None


_BEFORE_ALL = frozenset(
    ("worker_lost", "worker_silent", "port_lost", "unit_unknown", "unit_offline", "estop_active")
)
"""While one of these holds, nothing else about a unit matters."""


@dataclass(frozen=True, slots=True)
class UnitView:
    """The presentation of a unit. ``cause``: that of its first line; ``blocked``: why commands are
    blocked."""

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
    """Return the number of units in each state, and ``online``. A unit that does not respond is in no
    state."""
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
    """Return the cause for the first line of a unit: the first broken rung, else another abnormal condition.
    ``cause``: its ``unit_cause``; ``blocked``: why commands are blocked, None if they are not; ``drifted``:
    in what it departs from its golden set, empty if in nothing."""
    if cause is not None and cause.code in _BEFORE_ALL:
        return cause
    suspected = suspicion(bus, unit)
    others = _others(cause, _draw(bus, unit, now), implausible_of(unit), suspected, blocked, drifted)
    return next(others, cause)


def timed_as_alarm(
    cause: Cause | None, place: str, alarm_since: Callable[[str, str], UnixTime | None]
) -> Cause | None:
    """Return a cause with the time at which its alarm came, while that is active: both are said of one unit,
    and an alarm comes later than its condition by its delay. ``place``: the key of the unit."""
    row = None if cause is None else TILES.get(cause.code)
    at = None if row is None else alarm_since(place, row.code)
    return cause if at is None or cause is None else replace(cause, onset=Onset(at))


def are_alike(one: Cause | None, other: Cause | None) -> bool:
    """Return whether one sentence says both: what is so, of which motion, and since which minute."""
    if one is None or other is None or (one.code, one.params) != (other.code, other.params):
        return False
    [since, other_since] = [each.onset and float(each.onset.at) // 60 for each in (one, other)]
    return since == other_since


_BESIDE_RUNNING = frozenset(("not_in_remote", "blocked", "drift"))


def is_beside_running(cause: Cause | None) -> bool:
    """Return whether a cause has low priority and does not affect how its unit runs."""
    return cause is not None and cause.level == "low" and cause.code in _BESIDE_RUNNING


def _draw(bus: BusLive, unit: UnitLive, now: UnixTime) -> Cause | None:
    """Return a draw out of its band as a cause, once it has lasted for the delay of its alarm. While it is
    not judged it stays as it was, unless the unit before is lost, so that nobody knows it."""
    onset = unit.onsets.since.get(DRAW_OUT_OF_BAND.code)
    if onset is None or now - onset.at < DRAW_OUT_OF_BAND.tuning.on_delay_s:
        return None
    draw = draw_of(bus, unit, now)
    before = bus.units[bus.seams[unit.settings.id].before]
    is_lost = draw.state == "unknown" and unit_link_now(bus, before, now) in ("offline", "unknown")
    if DRAW_OUT_OF_BAND.holds(draw) is False or is_lost:
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


def no_response_cause(bus: BusLive, now: UnixTime) -> Cause | None:
    """Return one cause for all units of a bus if none responds: its connection, else since the last of them
    was lost; None if a unit responds, or if the only unit of the bus is lost."""
    if (connection := connection_cause(bus, now)) is not None:
        return connection
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


def no_response_text(bus: BusLive, now: UnixTime) -> Message | None:
    """Return the words of a tile for the cause of all units of a bus; None if there is no such cause."""
    cause = no_response_cause(bus, now)
    return None if cause is None else tile_text(cause.code)
