"""The feed as a feature: readings come in from the worker of each bus, commands go out to it."""

from __future__ import annotations

from app.core.database import Database
from app.core.web.services import Registry
from app.feature import Feature, Services
from app.line.feed import socket
from app.line.feed.bus_feed import BusFeed, HeldSpeeds
from app.line.feed.channel import Channel
from app.line.feed.socket import Workers
from app.line.history.service import History
from app.line.live.bus_live import BusLive
from app.line.live.change_recorder import ChangeRecorder
from app.line.live.hub import Hub
from app.line.pipeline import Pipeline


def make(services: Services) -> None:
    for name, bus in services.buses.items():
        _make_of_bus(services, name, bus)
    services.add(Workers(services.of_buses(BusFeed), services[ChangeRecorder]))


def _make_of_bus(services: Services, name: str, bus: Registry) -> None:
    history = services[History]
    pipeline = bus.add(Pipeline(bus[BusLive], history, bus[ChangeRecorder]))
    held = bus.add(HeldSpeeds(bus[BusLive], services[Database]))
    feed = bus.add(BusFeed(bus.add(Channel()), pipeline, held))
    services[Hub].watchers[name] = feed.watch
    services.lifespan.add(f"staged speeds of {name}", held.follow, start=held.load)
    services.lifespan.add(f"feed of {name}", start=lambda: feed.load(history.newest(name)))


FEATURE = Feature(make, (socket.router,))
