"""The range of a unit's setpoint, for labels, number pad, reviews, checks and the API alike. Pure.

==========  =======================================================================================
a speed     0 to #2, the number displayed at full scale. An engineer's own highest setpoint takes its
            place, and may be above it. Without either the protocol's limit holds (manual, 82h) and the
            unit decides: one without #2 (NAK 82h), or with 0 there, states no limit
a ratio     #38 to #31, which an engineer's own limits can only narrow
==========  =======================================================================================
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from app.line.commands.safeguards.limits import HIGHEST_SETPOINT, Limits
from app.line.live.state.bus_live import UnitLive, follower
from bus.catalogue.numbers import (
    FOLLOWER_MODE,
    MAX_DISPLAY,
    MAX_RATIO,
    MIN_RATIO,
    RATIO_SETPOINT,
    SPEED_SETPOINT,
)
from bus.catalogue.parameters import PARAMETERS

SetpointKind = Literal["speed", "ratio"]
Basis = Literal["protocol", "display", "ratio", "limits"]
"""Source of the limit: 82h, #2, #38 and #31, or an engineer."""
KIND_OF_PARAMETER: dict[int, SetpointKind] = {SPEED_SETPOINT: "speed", RATIO_SETPOINT: "ratio"}
"""The parameters in which a unit keeps its setpoint."""
_DECIDING: dict[SetpointKind, tuple[int, ...]] = {
    "speed": (MAX_DISPLAY,),
    "ratio": (MAX_RATIO, MIN_RATIO),
}


@dataclass(frozen=True, slots=True)
class SetpointRange:
    """Raw, both ends included."""

    kind: SetpointKind
    lowest: int
    highest: int
    basis: Basis

    def allows(self, raw: int) -> bool:
        """Whether it is inside. Speed 0 always is: no limit may keep a line from being set to zero."""
        return self.lowest <= raw <= self.highest or (raw == 0 and self.kind == "speed")

    def nearest(self, raw: int) -> int:
        """The closest that is inside."""
        return min(max(raw, self.lowest), self.highest)


def kind_of(unit: UnitLive) -> SetpointKind:
    """What the unit's own setpoint is, by #8; a speed while that was not read."""
    return "ratio" if follower(unit) else "speed"


def setpoint_range(unit: UnitLive, limits: Limits, kind: SetpointKind | None = None) -> SetpointRange:
    """``kind``: of the setpoint where it is not the unit's own, as a master has a ratio in #37 too; the
    engineer's ``limits`` are for its own."""
    own = kind_of(unit)
    kind = kind or own
    found = _of_the_unit(unit, kind)
    return _narrowed(found, limits) if kind == own else found


def is_above_display(unit: UnitLive, raw: int) -> bool:
    """Whether a speed is above #2, as only an engineer's own limit allows it."""
    return kind_of(unit) == "speed" and raw > (unit.parameter_raw(MAX_DISPLAY) or HIGHEST_SETPOINT)


def unread_for_range(
    unit: UnitLive, limits: Limits, raw: int, kind: SetpointKind | None = None
) -> tuple[int, ...]:
    """What has to be read before it is known whether ``raw`` is inside; empty where nothing is missing."""
    kind = kind or kind_of(unit)
    if raw == 0 and kind == "speed":
        return ()
    replaced = kind == kind_of(unit) == "speed" and limits.highest is not None
    deciding = (FOLLOWER_MODE,) if replaced else (FOLLOWER_MODE, *_DECIDING[kind])
    return tuple(number for number in deciding if number not in unit.parameters)


def parameter_bounds(unit: UnitLive, number: int, limits: Limits) -> tuple[int, int]:
    """Lowest and highest raw value of a parameter: as the manual lists it, and where it is a setpoint, as
    that setpoint may be."""
    parameter, kind = PARAMETERS[number], KIND_OF_PARAMETER.get(number)
    if kind is None:
        return parameter.minimum, parameter.maximum
    found = setpoint_range(unit, limits, kind)
    return found.lowest, found.highest


def _of_the_unit(unit: UnitLive, kind: SetpointKind) -> SetpointRange:
    if kind == "speed":
        most = unit.parameter_raw(MAX_DISPLAY)
        return SetpointRange(
            kind, 0, _within_protocol(most or HIGHEST_SETPOINT), "display" if most else "protocol"
        )
    least, most = unit.parameter_raw(MIN_RATIO) or 0, unit.parameter_raw(MAX_RATIO)
    basis: Basis = "ratio" if least or most else "protocol"
    return SetpointRange(
        kind, _within_protocol(least), _within_protocol(max(least, most or HIGHEST_SETPOINT)), basis
    )


def _narrowed(found: SetpointRange, limits: Limits) -> SetpointRange:
    """What an engineer's limits leave of a range. A highest speed replaces #2; nothing else widens it."""
    lowest, highest = found.lowest, found.highest
    if limits.highest is not None:
        own = max(lowest, min(highest, limits.highest))
        highest = _within_protocol(limits.highest) if found.kind == "speed" else own
    if limits.lowest is not None:
        lowest = min(max(lowest, limits.lowest), highest)
    if (lowest, highest) == (found.lowest, found.highest):
        return found
    return SetpointRange(found.kind, lowest, highest, "limits")


def _within_protocol(raw: int) -> int:
    return min(raw, HIGHEST_SETPOINT)
