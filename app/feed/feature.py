"""The way of readings in and of commands out: what the worker of each bus opens."""

from __future__ import annotations

from app.feature import Feature, Services
from app.feed import socket
from app.feed.bus_feed import BusFeed
from app.feed.channel import Channel
from app.feed.workers import Workers
from app.history.service import History
from app.live.change_recorder import ChangeRecorder
from app.live.state.bus_live import BusLive
from app.pipeline import Pipeline
from app.web.services import Registry


def make(services: Services) -> None:
    for name, bus in services.buses.items():
        _make_of_bus(services, name, bus)
    services.add(Workers(services.of_buses(BusFeed), services[ChangeRecorder]))


def _make_of_bus(services: Services, name: str, bus: Registry) -> None:
    history = services[History]
    pipeline = bus.add(Pipeline(bus[BusLive], history, bus[ChangeRecorder]))
    feed = bus.add(BusFeed(bus.add(Channel()), pipeline))
    services.lifespan.add(f"feed of {name}", start=lambda: feed.load(history.newest(name)))


FEATURE = Feature(make, (socket.router,))
