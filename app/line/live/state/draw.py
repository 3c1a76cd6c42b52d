"""The draw of a unit now, from the actual speeds that it and the unit before it reported. Pure."""

from __future__ import annotations

from typing import TYPE_CHECKING

from app.line.conditions.draw import NO_DRAW, Draw, SectionSpeed, draw_between
from app.line.conditions.evidence import reads_ratio
from app.line.conditions.of_unit import SETTLED
from app.line.live.state.age import unit_link_now
from bus.catalogue.numbers import DECIMALS
from bus.instants import UnixTime

if TYPE_CHECKING:
    from app.line.live.state.bus_live import BusLive, UnitLive


def draw_of(bus: BusLive, unit: UnitLive, now: UnixTime) -> Draw:
    """Judged while both sections run and neither ramps."""
    seam = bus.seams.get(unit.settings.id)
    if seam is None:
        return NO_DRAW
    before = bus.units[seam.before]
    judged = before.motion.state in SETTLED and unit.motion.state in SETTLED
    speeds = _actual_speed(bus, before, now), _actual_speed(bus, unit, now)
    return draw_between(*speeds, seam.band, judged=judged)


def quantity_of(bus: BusLive, unit: UnitLive) -> str | None:
    """What the speeds of a unit are measured in, by its label; None where they are ratios."""
    return None if reads_ratio(bus, unit) else unit.settings.labels.unit


def _actual_speed(bus: BusLive, unit: UnitLive, now: UnixTime) -> SectionSpeed:
    reading = unit.reading if unit_link_now(bus, unit, now) == "online" else None
    raw = None if reading is None else reading.actual
    return SectionSpeed(raw, unit.parameter_raw(DECIMALS), quantity_of(bus, unit))
