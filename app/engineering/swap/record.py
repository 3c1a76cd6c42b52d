"""One swap: who began it, what the spare shall become, what was seen since, the restore it led to."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field

from app.engineering.sets.restore.record import Restore
from app.engineering.swap.rules import SwapState, finding
from bus.instants import UnixTime
from bus.messages import Message, listed


@dataclass(frozen=True, slots=True)
class SwapSource:
    """The unit of a stored set that the spare shall become: mostly the section's own, or a sister's."""

    set: int
    unit: int

    def message(self, unit: int) -> Message:
        """Which set, and of which unit where that is another than ``unit``."""
        if self.unit == unit:
            return Message.of("set_numbered", set=self.set)
        return Message.of("set_of_unit", set=self.set, unit=self.unit)


@dataclass(slots=True)
class Swap:
    """``source`` None: nothing is stored, the spare is entered from the sheet. ``is_new``: the unit at
    the section's address is the spare, as the address was empty at the beginning or a person confirmed it.
    ``seen``: findings on the wire, each once, in order."""

    bus: str
    unit: int
    who: str
    source: SwapSource | None
    began_at: UnixTime
    is_new: bool = False
    seen: list[Message] = field(default_factory=list)
    restore: Restore | None = None
    proven: bool = False
    state: SwapState | None = None
    """What the last look showed."""
    look: asyncio.Task[SwapState] | None = None

    def saw(self, state: SwapState) -> bool:
        """The wire was looked at; whether it showed anything new."""
        self.state = state
        before = self.is_new, len(self.seen)
        if state.at_target == "silent":
            self.is_new = True
        found = finding(state)
        if not self.seen or self.seen[-1] != found:
            self.seen.append(found)
        return before != (self.is_new, len(self.seen))

    @property
    def equal(self) -> bool | None:
        """Whether the spare equals the set, by the full read after the last restore."""
        if self.proven:
            return True
        if self.restore is None or self.restore.state == "planned":
            return None
        return self.restore.state == "equal"

    @property
    def not_restored(self) -> list[int]:
        """The rows of the set that the spare was not given, as it lacks them or they were not chosen."""
        restore = self.restore
        if restore is None:
            return []
        return [
            left.number
            for left in restore.left_out
            if left.reason != "address" and restore.wanted.raw(left.number) is not None
        ]

    @property
    def source_message(self) -> Message:
        """Where its parameters come from."""
        return Message("swap_sheet") if self.source is None else self.source.message(self.unit)

    @property
    def story(self) -> Message:
        """What was seen, in order."""
        return Message.of("swap_seen", findings=listed(self.seen))
