"""What an alarm with other limits would have done with stored readings."""

from __future__ import annotations

from app.alarms.simulation import api, pages
from app.alarms.simulation.simulator import Simulator
from app.feature import Feature, Services
from app.history.service import History


def make(services: Services) -> None:
    services.add(Simulator(services[History]))


FEATURE = Feature(make, (api.router, pages.router))
