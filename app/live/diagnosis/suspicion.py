"""Whether another unit may be responding in place of a unit. Pure.

A response carries only the address that was requested: one that comes from a unit with a broken
address decoder looks like the right one. Two signs show it: the address that the responding unit reads in its
#17, and that every response but its own comes twice.
"""

from __future__ import annotations

from app.live.state.bus_live import BusLive, UnitLive
from bus.catalogue.numbers import OWN_ADDRESS
from bus.messages import Message


def suspicion(bus: BusLive, unit: UnitLive) -> Message | None:
    """Why the values shown for ``unit`` may be another's; None where there is no sign of it.

    It warns and forbids nothing: an address changed at the panel (#17) may apply from the next power-up only.
    """
    own = unit.parameter_raw(OWN_ADDRESS)
    if own not in (None, unit.settings.id) and _most_read_their_own_address(bus):
        return Message.of("suspect_by_address", unit=own or 0)
    responder = bus.figures.responds_for_all if bus.figures is not None else 0
    if responder not in (0, unit.settings.id):
        return Message.of("suspect_by_duplicates", unit=responder)
    return None


def _most_read_their_own_address(bus: BusLive) -> bool:
    """Where they do not, #17 of these units has another meaning, and no address can be checked."""
    read = [(unit.parameter_raw(OWN_ADDRESS), unit.settings.id) for unit in bus.units.values()]
    matches = [own == address for own, address in read if own is not None]
    return 2 * sum(matches) > len(matches)
