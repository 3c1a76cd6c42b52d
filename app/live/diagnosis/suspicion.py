"""Whether another unit may be answering in a unit's name. Pure.

An answer bears the address that was asked and nothing else, so one that comes from a unit with a broken
address decoder looks like the right one. Two things speak: the address that whoever answers reads in its own
#17, and that every answer but its own comes twice.
"""

from __future__ import annotations

from app.live.state.bus_live import BusLive, UnitLive
from bus.catalogue.numbers import OWN_ADDRESS
from bus.messages import Message


def suspicion(bus: BusLive, unit: UnitLive) -> Message | None:
    """Why the values shown for ``unit`` may be another's; None where nothing says so.

    It warns and forbids nothing: an address changed at the panel (#17) may hold from the next power-up only.
    """
    own = unit.parameter_raw(OWN_ADDRESS)
    if own not in (None, unit.settings.id) and _most_read_their_own_address(bus):
        return Message.of("suspect_by_address", unit=own or 0)
    everybody = bus.figures.answers_for_all if bus.figures is not None else 0
    if everybody not in (0, unit.settings.id):
        return Message.of("suspect_by_duplicates", unit=everybody)
    return None


def _most_read_their_own_address(bus: BusLive) -> bool:
    """Where they do not, #17 says something else in these units, and nothing about who answers."""
    read = [(unit.parameter_raw(OWN_ADDRESS), unit.settings.id) for unit in bus.units.values()]
    said = [own == address for own, address in read if own is not None]
    return 2 * sum(said) > len(said)
