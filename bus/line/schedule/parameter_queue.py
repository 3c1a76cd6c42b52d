"""Which parameter is read next in the gaps of the scan. Pure: order only, no time."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from bus.catalogue.numbers import DECIMALS, FOLLOWER_MODE, MAX_DISPLAY

UnitParameter = tuple[int, int]
"""A unit and the number of a parameter."""
DECIMALS_EVERY = 4
"""This many reads of the slow scan include one #3, and a first reading of all the others still ends soon."""
_FIRST = (DECIMALS, FOLLOWER_MODE, MAX_DISPLAY)
"""Of all units before the other needed ones, in this order: without decimals no speed can be shown right, and
a setpoint waits until the mode and #2, which bound it, are read."""
_RANKS = {number: rank for rank, number in enumerate(_FIRST)}


class ParameterQueue:
    """Two queues of 85h reads: those needed to show a unit right, and a slow scan of all others.

    The needed ones go number by number over all units, so that all units are shown right together. The slow
    scan never ends: what was read goes to its end, which finds what was changed at a panel. Every fourth read
    of it is #3 of the next unit, because decimals changed at a panel make every shown speed wrong.
    """

    def __init__(self, numbers: Sequence[int], needed: Collection[int]) -> None:
        self._numbers = tuple(numbers)
        self._needed_numbers = frozenset(needed)
        self._needed: dict[UnitParameter, tuple[int, int, int]] = {}
        """With the rank of each."""
        self._background: dict[UnitParameter, None] = {}
        self._decimals: dict[UnitParameter, None] = {}
        self._arrivals = 0
        self._turn = 0

    def learn_all(self, unit: int) -> None:
        """``unit`` is new or has returned: everything about it is to be read."""
        self.forget(unit)
        self.need(unit)
        for number in self._numbers:
            if number not in self._needed_numbers:
                self._add_background(unit, number)

    def need(self, unit: int) -> None:
        """Read again what is needed to show ``unit`` right."""
        for number in self._needed_numbers:
            self._add_needed(unit, number, _RANKS.get(number, len(_FIRST)))

    def forget(self, unit: int) -> None:
        """``unit`` does not respond; nothing is read from it."""
        for queue in (self._needed, self._background, self._decimals):
            for entry in [entry for entry in queue if entry[0] == unit]:
                del queue[entry]

    def next_needed(self) -> UnitParameter | None:
        """Unit and number of the next needed parameter, taken from the queue."""
        if not self._needed:
            return None
        entry = min(self._needed, key=self._needed.__getitem__)
        del self._needed[entry]
        return entry

    def next_background(self) -> UnitParameter | None:
        """Return unit and number of the next parameter of the slow scan, and remove it from there."""
        self._turn = (self._turn + 1) % DECIMALS_EVERY
        queue = (self._background or self._decimals) if self._turn else (self._decimals or self._background)
        if not queue:
            return None
        entry = next(iter(queue))
        del queue[entry]
        return entry

    def was_read(self, unit: int, number: int, *, available: bool) -> None:
        """Move it to the end of the slow scan; remove one that the unit does not have."""
        if available and number in self._numbers:
            self._add_background(unit, number)

    def was_not_read(self, unit: int, number: int) -> None:
        """No response: put it back into the queue it came from."""
        if number in self._needed_numbers:
            self._add_needed(unit, number, len(_FIRST))
        else:
            self._add_background(unit, number)

    def _add_needed(self, unit: int, number: int, rank: int) -> None:
        self._arrivals += 1
        self._needed.setdefault((unit, number), (rank, number, self._arrivals))

    def _add_background(self, unit: int, number: int) -> None:
        queue = self._decimals if number == DECIMALS else self._background
        queue.setdefault((unit, number))
