"""Notices that the holder of control has left without releasing it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Mapping

from app.alarms.bus_alarms import BusAlarms
from app.conditions.of_bus import CONTROL_LEFT
from app.web.access import account_shown
from bus.instants import Monotonic, MonotonicClock, monotonic_now
from bus.messages import Message

LOOK_EVERY_S = 5.0
HeldControl = tuple[str, Monotonic]
"""The account, and when it last sent a command."""
ControlLookup = Callable[[], HeldControl | None]


class ControlWatch:
    """Of all buses. ``held``: who holds control of each; ``present``: the accounts with an open page."""

    def __init__(
        self,
        buses: Mapping[str, BusAlarms],
        held: Mapping[str, ControlLookup],
        present: Callable[[], Collection[str]],
        clock: MonotonicClock = monotonic_now,
    ) -> None:
        self._buses = buses
        self._held = held
        self._present = present
        self._clock = clock

    async def follow(self) -> None:
        """Look every few seconds, without end."""
        while True:
            self.look()
            await asyncio.sleep(LOOK_EVERY_S)

    def look(self) -> None:
        """Look once."""
        present = self._present()
        for name, bus in self._buses.items():
            bus.see_control(self._left_by(self._held[name](), present))

    def _left_by(self, held: HeldControl | None, present: Collection[str]) -> Message | None:
        if held is None:
            return None
        account, used_at = held
        if not CONTROL_LEFT.holds(self._clock() - used_at, account in present):
            return None
        return Message.of("alarm_control_left_by", who=account_shown(account))
