"""The state of each unit: its link, its newest values, its staged value, and counts of its exchanges. Pure.

Nothing here is guessed: a value comes from a response, and an offline unit keeps its last one with its age.
Methods return the updates for the app. Times: seconds since the epoch.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from msgspec.structs import asdict

from bus.catalogue.parameters import PARAMETERS
from bus.catalogue.values import plausible_parameter, plausible_speed
from bus.contract import (
    ParameterValue,
    Reading,
    Staged,
    UnitCounts,
    UnitFigures,
    UnitLink,
    UnitLinkState,
    UnitScale,
    UnitState,
)
from bus.errors import UnitErrorCode
from bus.instants import UnixTime
from bus.messages import Message
from bus.wire.commands import (
    Ack,
    ExecuteSpeedRequest,
    Nak,
    ParameterReply,
    ReadParameterRequest,
    ReadStatusRequest,
    Reply,
    Request,
    SetAndExecuteSpeedRequest,
    StageSpeedRequest,
    StatusReply,
)


@dataclass(slots=True)
class WireCounts:
    """The totals of what the wire has carried."""

    busy_s: float = 0.0
    noise_bytes: int = 0
    echoes: int = 0


_SHORTEST_S = 0.0001
_STEP = 1.08
"""The ratio of neighboring classes of response times, which are 8 % apart, from 0.1 ms to 8 s."""
_CLASSES = 148


class ResponseTimes:
    """A histogram of the seconds from a request's last byte to the first byte of the response."""

    __slots__ = ("_classes", "count", "largest", "smallest")

    def __init__(self) -> None:
        self._classes = [0] * _CLASSES
        self.count = 0
        self.smallest: float | None = None
        self.largest: float | None = None

    def add(self, seconds: float) -> None:
        """Add one response; a negative time (a port faster than its baud rate) counts as zero."""
        seconds = max(seconds, 0.0)
        self.count += 1
        self._classes[_class_of(seconds)] += 1
        self.smallest = seconds if self.smallest is None else min(self.smallest, seconds)
        self.largest = seconds if self.largest is None else max(self.largest, seconds)

    def quantile(self, part: float) -> float | None:
        """Return the time in seconds that ``part`` (0 to 1) of the responses did not exceed, if any."""
        if self.smallest is None or self.largest is None:
            return None
        left = part * self.count
        # This runs every second, twice for each unit, so the empty classes before the first are skipped.
        for place in range(_class_of(self.smallest), _CLASSES):
            left -= self._classes[place]
            if left <= 0 and self._classes[place]:
                middle = _SHORTEST_S * _STEP ** (place - 0.5) if place else 0.0
                return min(max(middle, self.smallest), self.largest)
        return self.largest


def _class_of(seconds: float) -> int:
    if seconds <= _SHORTEST_S:
        return 0
    return min(int(math.log(seconds / _SHORTEST_S) / math.log(_STEP)) + 1, _CLASSES - 1)


class UnitStatistics:
    """The counts of all requests to one unit, by how they ended."""

    __slots__ = ("counts", "times")

    def __init__(self, unit: int) -> None:
        self.counts = UnitCounts(unit)
        self.times = ResponseTimes()

    def count(self, request: Request, reply: Reply | None, response_s: float) -> None:
        """Count an exchange; ``response_s``: from the request's last byte to the first of ``reply``."""
        self.counts.polls += isinstance(request, ReadStatusRequest)
        if reply is None:
            self.counts.timeouts += 1
            return
        self.counts.responses += 1
        self.times.add(response_s)
        if isinstance(reply, Nak):
            # This makes a new dictionary, because the former one may have been reported.
            naks = self.counts.naks
            self.counts.naks = {**naks, reply.code: naks.get(reply.code, 0) + 1}

    def figures(self) -> UnitFigures:
        times = self.times
        return UnitFigures(
            **asdict(self.counts),
            response_s_min=times.smallest,
            response_s_median=times.quantile(0.5),
            response_s_p99=times.quantile(0.99),
            response_s_max=times.largest,
        )


UnitUpdate = Reading | ParameterValue | UnitLink | Staged
MISSES_TO_STALE = 2
MISSES_TO_OFFLINE = 3
"""The number of misses in a row that make a unit unresponsive; a single one is retried and not reported."""
LOST_AFTER_S = 1.0
"""The seconds after which an unresponsive unit is offline: three requests pass in 0.1 s, and a short burst of
noise must lose no unit."""


@dataclass(slots=True)
class UnitRecord:
    """The state of one unit. ``misses``: requests in a row without a response since ``responded_at``."""

    unit: int
    link: UnitLink
    misses: int = 0
    responded_at: UnixTime | None = None
    reading: Reading | None = None
    parameters: dict[int, ParameterValue] = field(default_factory=dict)
    staged: int | None = None
    staged_unknown: bool = False
    """Whether its staged speed is unknown: 82h was not acknowledged, or it was away while it held one."""
    staged_scale: UnitScale = field(default_factory=dict)
    """The parameters with which the staged speed was converted; empty if it was given raw."""
    statistics: UnitStatistics = field(init=False)

    def __post_init__(self) -> None:
        self.statistics = UnitStatistics(self.unit)

    @property
    def unresponsive(self) -> bool:
        """Whether the unit need not be polled in every scan any more."""
        return self.misses >= MISSES_TO_OFFLINE

    def lost(self, at: UnixTime) -> bool:
        """Return whether the unit has been unresponsive for long enough; a clock that was set back counts as
        long."""
        return self.unresponsive and (
            self.responded_at is None or not 0 <= at - self.responded_at < LOST_AFTER_S
        )

    @property
    def commanded(self) -> int | None:
        """The commanded speed as last read; None if it never was, or if no unit can have such a speed."""
        return plausible_speed(self.reading.commanded) if self.reading is not None else None

    def raw(self, number: int) -> int | None:
        """Return a parameter as last read; None if it never was, the unit does not have it, or it is outside
        of its documented range."""
        known = self.parameters.get(number)
        return plausible_parameter(number, known.raw) if known is not None else None


class Roster:
    """The configured units in floor order, and any other to which a command was sent."""

    def __init__(self, units: Iterable[int], at: UnixTime) -> None:
        self.configured = tuple(units)
        """The addresses of the configuration, in floor order."""
        self._known = frozenset(self.configured)
        self._records = {unit: _stranger(unit, at) for unit in self.configured}

    def __iter__(self) -> Iterator[UnitRecord]:
        return iter(self._records.values())

    def __getitem__(self, unit: int) -> UnitRecord:
        record = self._records.get(unit)
        if record is None:
            record = self._records[unit] = _stranger(unit, UnixTime(0.0))
        return record

    @property
    def unresponsive(self) -> frozenset[int]:
        """The configured units that need not be polled in every scan."""
        return frozenset(unit for unit in self.configured if self._records[unit].unresponsive)

    def is_configured(self, unit: int) -> bool:
        return unit in self._known

    def states(self) -> list[UnitState]:
        records = map(self._records.__getitem__, self.configured)
        return [
            UnitState(
                each.unit,
                each.link,
                each.reading,
                list(each.parameters.values()),
                each.staged,
                each.staged_unknown,
            )
            for each in records
        ]

    # --- responses of a unit -------------------------------------------------------------------

    def take_response(
        self, request: Request, reply: Reply, at: UnixTime, frame: bytes, *, is_probe: bool = False
    ) -> list[UnitUpdate]:
        """Take ``reply``, the response to ``request``, and return the updates. A probe is not encoded in the
        unit's dialect: it shows that the unit responds, but its parameter number and value are not
        certain."""
        record = self[request.unit]
        record.misses, record.responded_at = 0, at
        updates = self._link(record, "online", at, None)
        match request, reply:
            case ReadParameterRequest(number=number), _ if is_probe or number not in PARAMETERS:
                pass
            case _, StatusReply():
                record.reading = Reading(at=at, **asdict(reply))
                updates.append(record.reading)
            case ReadParameterRequest(number=number), _:
                value = parameter_value(record.unit, number, reply, at, frame)
                if value is not None:
                    record.parameters[number] = value
                    updates.append(value)
            case StageSpeedRequest(), Ack():
                updates += self.stage(record.unit, request.raw, at)
            case ((ExecuteSpeedRequest() | SetAndExecuteSpeedRequest()), Ack()):
                updates += self.stage(record.unit, None, at)
        return updates if self.is_configured(record.unit) else []

    def missed(self, unit: int, at: UnixTime) -> list[UnitUpdate]:
        """Count a request without a response; return the updates of the link."""
        record = self[unit]
        record.misses += 1
        if record.lost(at):
            return self._link(record, "offline", at, Message.of("responses_missed", count=MISSES_TO_OFFLINE))
        if record.link.link == "online" and record.misses >= MISSES_TO_STALE:
            return self._link(record, "stale", at, Message("response_overdue"))
        return []

    def port_closed(self, at: UnixTime, cause: Message, *, long: bool = False) -> list[UnitUpdate]:
        """Note that no unit can be polled: online units become stale, and if ``long``, stale ones offline."""
        was: UnitLinkState = "stale" if long else "online"
        becomes: UnitLinkState = "offline" if long else "stale"
        records = [record for record in self._records.values() if record.link.link == was]
        return [update for record in records for update in self._link(record, becomes, at, cause)]

    def stage(self, unit: int, raw: int | None, at: UnixTime, *, unknown: bool = False) -> list[UnitUpdate]:
        """Note that ``unit`` has staged ``raw``; None: it holds no staged speed, or an unknown one."""
        record = self[unit]
        former = record.staged, record.staged_unknown
        record.staged, record.staged_unknown, record.staged_scale = raw, unknown, {}
        if former == (raw, unknown) or not self.is_configured(unit):
            return []
        return [Staged(unit, at, raw, unknown)]

    def note_held(self, units: Iterable[int], at: UnixTime) -> None:
        """Note the units that may hold a speed which an earlier worker has staged in them: also those that
        are not configured any more, which a broadcast moves as well."""
        for unit in units:
            self.stage(unit, None, at, unknown=True)

    def stage_unanswered(self, unit: int, at: UnixTime) -> list[UnitUpdate]:
        """Note that 82h got no response: ``unit`` may hold the new speed or its former one. A unit that was
        away already has most likely received nothing."""
        away = self[unit].link.link not in ("online", "stale")
        return [] if away else self.stage(unit, None, at, unknown=True)

    def _link(
        self, record: UnitRecord, link: UnitLinkState, at: UnixTime, cause: Message | None
    ) -> list[UnitUpdate]:
        if record.link.link == link:
            return []
        record.link = UnitLink(unit=record.unit, at=at, link=link, cause=cause)
        updates: list[UnitUpdate] = [record.link]
        if link == "offline" and record.staged is not None:
            # The unit may have been switched off, and holds another speed when it is on again.
            updates += self.stage(record.unit, None, at, unknown=True)
        return updates if self.is_configured(record.unit) else []


def _stranger(unit: int, at: UnixTime) -> UnitRecord:
    return UnitRecord(unit, UnitLink(unit=unit, at=at, link="unknown", cause=Message("no_response_yet")))


def parameter_value(
    unit: int, number: int, reply: Reply | None, at: UnixTime, frame: bytes
) -> ParameterValue | None:
    """Return the value in a response to 85h, or None if there is none. NAK 82h: the unit lacks the
    parameter."""
    match reply:
        case ParameterReply():
            return ParameterValue(unit, number, at, reply.raw, frame=frame)
        case Nak(code=UnitErrorCode.ILLEGAL_PARAMETER_NUMBER):
            return ParameterValue(unit, number, at, None, available=False, frame=frame)
    return None
