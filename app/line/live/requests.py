"""Parts that requests about the line share: the named bus or unit, the number of open pages, the ids of
commands."""

from __future__ import annotations

import uuid
from collections import Counter

from app.core.web.services import unknown_bus, unknown_unit
from app.line.live.bus_live import BusLive, LiveState, UnitLive


def bus_or_404(live: LiveState, bus: str) -> BusLive:
    """Return a configured bus. Raise Problem 404 for any other."""
    found = live.buses.get(bus)
    if found is None:
        raise unknown_bus(bus, live.buses)
    return found


def unit_or_404(live: LiveState, bus: str, unit: int) -> UnitLive:
    """Return a configured unit. Raise Problem 404 for any other."""
    return unit_of_bus_or_404(bus_or_404(live, bus), unit)


def unit_of_bus_or_404(bus: BusLive, unit: int) -> UnitLive:
    """Return a configured unit of this bus. Raise Problem 404 for any other."""
    found = bus.units.get(unit)
    if found is None:
        raise unknown_unit(bus.settings.name, unit)
    return found


MAX_PAGES_OF_ACCOUNT = 256
"""More than the 255 WebSockets that a browser opens to one server."""
MAX_PAGES_OF_ADDRESS = 512
"""More than for an account, because the browsers of a plant may share one address."""


class Admission:
    """The number of pages, or streams, that one account and one address have open.

    Beyond the limit the newest is refused. If an older one were closed in its place, two browsers that
    reconnect by themselves would push each other out without end.
    """

    def __init__(
        self, of_account: int = MAX_PAGES_OF_ACCOUNT, of_address: int = MAX_PAGES_OF_ADDRESS
    ) -> None:
        self._of_account = of_account
        self._of_address = of_address
        self._by_account: Counter[str] = Counter()
        self._by_address: Counter[str] = Counter()

    def enter(self, account: str, address: str) -> bool:
        """Count one more and return True, unless there would be too many. ``address``: as `source_of` names
        it."""
        if self._by_account[account] >= self._of_account or self._by_address[address] >= self._of_address:
            return False
        self._by_account[account] += 1
        self._by_address[address] += 1
        return True

    def leave(self, account: str, address: str) -> None:
        """Count one page or stream less."""
        for counter, key in ((self._by_account, account), (self._by_address, address)):
            counter[key] -= 1
            if not counter[key]:
                del counter[key]


_MARK = "#"


def new_command_id(key: str | None = None) -> str:
    """Return an id that no other command has or will have; ``key``: the name that its sender gives it.

    A worker carries out an id once and repeats its result when it gets the id again. The key alone is no id:
    another sender, or a later day, may use it again. By the key a page finds the progress of its command.
    """
    unique = uuid.uuid4().hex
    return unique if key is None else f"{key}{_MARK}{unique}"


def key_of(command_id: str) -> str:
    """Return the key that the sender gave a command; its id if there is none."""
    key, _, unique = command_id.rpartition(_MARK)
    return key or unique
