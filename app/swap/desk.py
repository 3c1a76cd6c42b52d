"""Swaps under way: who began which, what was seen since, the restore it led to, and the event at its end."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field, replace
from typing import Any

from app.audit.log import EventLog
from app.errors import Problem
from app.sets.restore_record import Restore
from app.swap.rules import Advice, Sight, seen_words
from app.web.access import Person

LOOK_WAIT_S = 2.0
"""How long a page waits for a look before it is told what the last one showed."""


@dataclass(slots=True)
class Swap:
    """One swap. ``is_new``: what answers at the section's address is the spare, for the address was silent
    since the beginning or a person said so. ``seen``: what the wire showed, each once, in order."""

    bus: str
    unit: int
    who: str
    source: int
    began_at: float
    is_new: bool = False
    seen: list[str] = field(default_factory=list)
    restore: Restore | None = None
    proven: bool = False
    sight: Sight | None = None
    """What the last look showed."""
    look: asyncio.Task[Sight] | None = None

    def saw(self, sight: Sight) -> None:
        """The wire was looked at."""
        self.sight = sight
        if sight.at_target == "silent":
            self.is_new = True
        words = seen_words(sight)
        if not self.seen or self.seen[-1] != words:
            self.seen.append(words)

    @property
    def equal(self) -> bool | None:
        """Whether the spare is what was asked, as the full read after the last restore says."""
        if self.restore is None or self.restore.state == "planned":
            return None
        return self.restore.state == "equal"


async def latest(swap: Swap, look: Callable[[], Coroutine[Any, Any, Sight]]) -> Sight | None:
    """What the wire shows, or showed at the last look where this one takes long; None before the first.

    One look at a time: it takes the gaps of the scan, and a page that asks again must not pile up more.
    Raises the Problem that ended the look.
    """
    running = swap.look = swap.look or asyncio.create_task(look(), name=f"look for the spare of {swap.unit}")
    done, _ = await asyncio.wait({running}, timeout=LOOK_WAIT_S)
    if done and swap.look is running:
        swap.look = None
        swap.saw(running.result())
    if swap.sight is None:
        return None
    return replace(swap.sight, is_new=swap.is_new, equal=swap.equal)


class SwapDesk:
    """One for the app. A swap that nobody ends goes on until the next of its unit, or the server's end."""

    def __init__(self, events: EventLog, clock: Callable[[], float]) -> None:
        self._events = events
        self._clock = clock
        self._swaps: dict[tuple[str, int], Swap] = {}

    def of(self, bus: str, unit: int) -> Swap | None:
        """The swap of a section, under way or just ended."""
        return self._swaps.get((bus, unit))

    def of_or_404(self, bus: str, unit: int) -> Swap:
        """The same. Raises Problem 404."""
        swap = self.of(bus, unit)
        if swap is None:
            raise Problem(404, "unknown_swap", f"no swap of unit {unit} has been begun; begin it first")
        return swap

    async def begin(self, person: Person, bus: str, unit: int, source: int) -> Swap:
        """Somebody changes the unit of a section; ``source`` is the set that the spare shall become."""
        swap = self._swaps[bus, unit] = Swap(bus, unit, person.name, source, self._clock())
        await self._record(swap, person.name, f"unit swap begun, from set {source}")
        return swap

    async def give_up(self, person: Person, swap: Swap) -> None:
        """It is not gone on with."""
        del self._swaps[swap.bus, swap.unit]
        await self._record(swap, person.name, "unit swap given up", ", then ".join(swap.seen))

    async def ended(self, restore: Restore) -> None:
        """A restore is over: where it belongs to a swap and proved equal, so is the swap."""
        swap = self.of(restore.bus, restore.unit)
        if swap is None or restore.planned_at < swap.began_at or swap.proven:
            return
        swap.restore = restore
        if restore.state != "equal":
            return
        swap.proven = True
        left_out = ", ".join(f"#{left.number}: {left.reason}" for left in restore.left_out)
        story = [
            f"seen: {', then '.join(swap.seen)}",
            f"restored from set {swap.source}: {restore.account() or 'nothing had to be written'}",
            f"left out: {left_out}" if left_out else "",
            "proven by a full read",
        ]
        message = "; ".join(part for part in story if part)
        await self._record(swap, restore.who, "unit swapped and proven", message, outcome="verified")

    async def _record(
        self, swap: Swap, who: str, what: str, message: str = "", outcome: str | None = None
    ) -> None:
        await self._events.record(
            kind="swap", who=who, bus=swap.bus, unit=swap.unit, what=what, message=message, outcome=outcome
        )


def step_text(advice: Advice, swap: Swap) -> str:
    """The sentence of the step; a restore that was tried says how it ended."""
    if advice.step == "restore" and swap.restore is not None and swap.equal is False:
        return "The restore is not finished. Review it again: only the rows that still differ are written."
    return advice.text
