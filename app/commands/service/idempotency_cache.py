"""The commands of all buses that are under way or just done, by the key of their sender."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from dataclasses import dataclass

from app.web.access import Person
from bus.contract import Action, Result

REMEMBERED = 1000
"""Results kept for senders that repeat a key."""


@dataclass(frozen=True, slots=True)
class KeptCommand:
    """A command that is under way or done."""

    bus: str
    action: Action
    result: asyncio.Task[Result]


class IdempotencyCache:
    """One for the site: a key belongs to its sender, whichever bus the command is for."""

    def __init__(self) -> None:
        self._kept: OrderedDict[tuple[str, str], KeptCommand] = OrderedDict()

    def find(self, person: Person, key: str | None) -> KeptCommand | None:
        """The command that this sender gave this key; None without one."""
        return None if key is None else self._kept.get((person.sender, key))

    def keep(self, person: Person, key: str, command: KeptCommand) -> None:
        """Bind the key to this command."""
        place = (person.sender, key)
        self._kept[place] = command
        while len(self._kept) > REMEMBERED and next(iter(self._kept.values())).result.done():
            self._kept.popitem(last=False)

        def forget_failed(result: asyncio.Task[Result]) -> None:
            # It has no result to give again: what was sent, if anything was, is on disk.
            if result.cancelled() or result.exception() is not None:
                self._kept.pop(place, None)

        command.result.add_done_callback(forget_failed)
