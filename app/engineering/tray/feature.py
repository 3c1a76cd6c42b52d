"""The change tray: changes that a person gathers for each bus and sends together."""

from __future__ import annotations

from typing import NamedTuple

from app.core.find.finders import Finders, FixedPlace
from app.core.messages import Language
from app.core.web.access import Caller
from app.core.web.templating import Templates
from app.engineering.tray import pages
from app.engineering.tray.contents import Trays
from app.feature import Feature, Services
from bus.instants import monotonic_now
from bus.messages import Message


class TrayCount(NamedTuple):
    """How much a person has gathered for one bus."""

    bus: str
    changes: int
    units: int


def make(services: Services) -> None:
    for bus in services.buses.values():
        bus.add(Trays())
    trays_of = services.of_buses(Trays)

    def counted(person: Caller | None, _: Language) -> list[TrayCount]:
        if person is None:
            return []
        now = monotonic_now()
        held = {name: trays.changes(person.sender, now) for name, trays in trays_of.items()}
        return [
            TrayCount(name, len(changes), len({place.unit for place in changes}))
            for name, changes in held.items()
            if changes
        ]

    services[Templates].parts["trays"] = counted
    services[Finders].add_links("find_actions", [FixedPlace(Message("find_tray"), "/tray", "SetLine")])


FEATURE = Feature(make, (pages.router,))
