"""Whether another unit may be answering in a unit's name. Pure.

An answer bears the address that was asked and nothing else, so one that comes from a unit with a broken
address decoder looks like the right one. Two things speak: the address that whoever answers reads in its own
#17, and that every answer but its own comes twice.
"""

from __future__ import annotations

from app.live.state import BusLive, UnitLive
from bus.catalogue.parameters import OWN_ADDRESS


def other_in_its_name(unit: UnitLive) -> int | None:
    """The address that whoever answers for ``unit`` has by its own #17; None while that is not another."""
    own = unit.parameter_raw(OWN_ADDRESS)
    return None if own == unit.settings.id else own


def suspicion(bus: BusLive, unit: UnitLive) -> str:
    """Why the values shown for ``unit`` may be another's, in words; empty where nothing says so."""
    other = other_in_its_name(unit)
    if other is not None:
        return f"perhaps unit {other} answers for it (#17)"
    everybody = bus.figures.answers_for_all if bus.figures is not None else 0
    if everybody not in (0, unit.settings.id):
        return f"perhaps unit {everybody} answers for it (each answer comes twice)"
    return ""
