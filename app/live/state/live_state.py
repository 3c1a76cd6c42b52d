"""The present state of every bus. Times are Unix times in seconds on the app's own clock; the feed shifts a
worker's times before they come here. What is overdue is not stored but computed from the age
(:mod:`app.live.state.age`): a worker that hangs cannot keep anything looking fresh.
"""

from __future__ import annotations

from collections.abc import Iterable

from app.live.state.bus_live import NO_WORKER, BusLive, BusSubscriber, UnitLive, follower, never_seen
from bus.instants import UnixTime
from bus.settings import BusSettings

__all__ = ["NO_WORKER", "BusLive", "BusSubscriber", "LiveState", "UnitLive", "follower"]


class LiveState:
    """Every configured bus, by its name."""

    def __init__(self, buses: Iterable[BusSettings], started_at: UnixTime) -> None:
        self.buses = {settings.name: never_seen(settings, started_at) for settings in buses}
