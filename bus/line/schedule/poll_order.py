"""Whose turn it is to be polled: a weighted round robin. Pure: it counts turns, not seconds."""

from __future__ import annotations

import heapq
import math
from collections.abc import Collection, Iterable

KEPT_OF_A_TURN = 2 / 3
"""The least part of its rate without open pages that an unwatched unit keeps."""
WATCHED_HZ = 10.0
"""More polls a second of one unit than this show a person nothing new."""


class PollOrder:
    """Units in floor order, each with its turn; a watched one has more turns than the others.

    Each unit has a *pass*; the lowest is next and moves on by the inverse of its share (stride scheduling),
    so no unit starves and equal units take exact turns. Whenever shares change the passes are spread evenly;
    otherwise a watched unit would have all its turns together, between two scans of the others.
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
        """Add ``unit`` as the last, because it has just responded; missed turns are not made up for."""
        if unit not in self._passes:
            self._passes[unit] = math.inf
            self._weigh()

    def leave(self, unit: int) -> None:
        if self._passes.pop(unit, None) is not None:
            self._weigh()

    def watch(self, units: Collection[int]) -> None:
        """These, where they take part, are polled at once, and more often from now on."""
        self._watched = frozenset(units)
        self._weigh()

    def take(self) -> int | None:
        """Return the unit whose turn it is; None when no unit takes part."""
        if not self._queue:
            return None
        self._present, place, unit = self._queue[0]
        turn = self._passes[unit] = self._present + self._strides[unit]
        heapq.heapreplace(self._queue, (turn, place, unit))
        return unit

    def share_of(self, unit: int) -> float:
        """The part of all polls that ``unit`` gets, 0 to 1."""
        return 1.0 / (len(self) * self._strides[unit]) if unit in self._passes else 0.0

    def _weigh(self) -> None:
        waiting = [unit for _, _, unit in sorted(self._entry(unit) for unit in self._passes)]
        watched = [unit for unit in waiting if unit in self._watched]
        others = [unit for unit in waiting if unit not in self._watched]
        extra, plain = _strides(len(self), len(watched), self._poll_s)
        self._spread(watched, extra)
        self._spread(others, plain)
        self._queue = [self._entry(unit) for unit in waiting]
        heapq.heapify(self._queue)

    def _spread(self, units: list[int], stride: float) -> None:
        """Evenly over one stride from the present turn on, in the order in which they wait."""
        for rank, unit in enumerate(units):
            self._strides[unit] = stride
            self._passes[unit] = self._present + stride * rank / len(units)

    def _entry(self, unit: int) -> tuple[float, int, int]:
        return self._passes[unit], self._place.get(unit, len(self._place)), unit


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
