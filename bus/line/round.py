"""Whose turn it is to be polled: a weighted round robin. Pure: it counts turns, not seconds."""

from __future__ import annotations

import heapq
from collections.abc import Collection, Iterable

KEPT_OF_A_TURN = 2 / 3
"""What an unwatched unit keeps, at the least, of the rate it has while nobody watches."""
WATCHED_HZ = 10.0
"""More polls a second of one unit than this show a person nothing new."""


class Round:
    """Units in floor order, each with its turn; a watched one has more turns than the others.

    Each unit has a *pass*; the lowest is next and moves on by the inverse of its share (stride
    scheduling), so nobody starves and equal units take exact turns.
    """

    def __init__(self, floor_order: Iterable[int], poll_s: float) -> None:
        self._place = {unit: place for place, unit in enumerate(floor_order)}
        self._poll_s = poll_s
        self._passes: dict[int, float] = {}
        self._queue: list[tuple[float, int, int]] = []
        self._watched: frozenset[int] = frozenset()
        self._strides: dict[int, float] = {}
        self._present = 0.0

    def __len__(self) -> int:
        return len(self._passes)

    def __contains__(self, unit: int) -> bool:
        return unit in self._passes

    def join(self, unit: int) -> None:
        """``unit`` takes part from the present turn on; what it missed is not made up for."""
        if unit not in self._passes:
            self._put(unit, self._present)
            self._weigh()

    def leave(self, unit: int) -> None:
        """``unit`` has no more turns."""
        if self._passes.pop(unit, None) is not None:
            self._weigh()

    def watch(self, units: Collection[int]) -> None:
        """These, where they take part, are polled more often from now on."""
        self._watched = frozenset(units)
        self._weigh()

    def take(self) -> int | None:
        """The unit whose turn it is; None when nobody takes part."""
        while self._queue:
            turn, _, unit = heapq.heappop(self._queue)
            if self._passes.get(unit) == turn:
                self._present = turn
                self._put(unit, turn + self._strides[unit])
                return unit
        return None

    def share_of(self, unit: int) -> float:
        """The part of all polls that ``unit`` gets, 0 to 1."""
        return 1.0 / (len(self) * self._strides[unit]) if unit in self._passes else 0.0

    def _put(self, unit: int, turn: float) -> None:
        self._passes[unit] = turn
        heapq.heappush(self._queue, (turn, self._place.get(unit, len(self._place)), unit))

    def _weigh(self) -> None:
        watched = self._watched & self._passes.keys()
        extra, plain = _strides(len(self), len(watched), self._poll_s)
        self._strides = {unit: extra if unit in watched else plain for unit in self._passes}


def _strides(units: int, watched: int, poll_s: float) -> tuple[float, float]:
    """How far the pass of a watched and of another unit moves in a turn; 1 is an equal share."""
    others = units - watched
    if watched == 0 or others == 0:
        return 1.0, 1.0
    equal = 1.0 / units
    left_by_others = 1.0 - KEPT_OF_A_TURN * others * equal
    each = max(equal, min(left_by_others / watched, WATCHED_HZ * poll_s))
    each_other = (1.0 - watched * each) / others
    return equal / each, equal / each_other
