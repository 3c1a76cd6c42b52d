"""The change tray: changes that a person gathers for each bus and sends together."""

from __future__ import annotations

from app.core.find.finders import Finders, FixedPlace
from app.core.web.access import Caller
from app.core.web.templating import HeadTray, TrayCount
from app.engineering.tray import pages
from app.engineering.tray.contents import Trays
from app.feature import Feature, Services
from bus.instants import monotonic_now
from bus.messages import Message


def make(services: Services) -> None:
    for bus in services.buses.values():
        bus.add(Trays())
    trays_of = services.of_buses(Trays)

    def counted(person: Caller) -> list[TrayCount]:
        now = monotonic_now()
        held = {name: trays.changes(person.sender, now) for name, trays in trays_of.items()}
        return [
            TrayCount(name, len(changes), len({place.unit for place in changes}))
            for name, changes in held.items()
            if changes
        ]

    services.add(HeadTray(counted))
    services[Finders].add_links("find_actions", [FixedPlace(Message("find_tray"), "/tray", "SetLine")])


FEATURE = Feature(make, (pages.router,))
