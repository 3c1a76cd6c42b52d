"""How much a worker may send. Pure.

Input over the rate is not read yet, and waits in the worker's own buffer. A worker that polls 255 units at
9600 baud, and is followed, sends a tenth of this. What no wire can have carried is shown, and not stored.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

from bus.contract import (
    Batch,
    BusFigures,
    BusLink,
    Frames,
    ParameterValue,
    Reading,
    Snapshot,
    UnitLink,
    Update,
    WorkerMessage,
)
from bus.instants import Monotonic
from bus.pacing import Bucket

PER_S = 2_000.0
"""Updates of the live state, each of which goes to every open page."""
MAX_AT_ONCE = 10_000.0
"""A complete snapshot, or the backlog of a quarter of an hour."""
LATE_COST = 0.25
"""Of an update that goes to history only."""
TEXT_COST = 40.0
"""Of a state, which history keeps and whose cause is translated for each language, or a diagnosis."""
MAX_BYTES_PER_S, MAX_BYTES_AT_ONCE = 100_000.0, 16_000_000.0
"""Of all messages; below 9 GB a day. A full buffer of a worker, with a complete snapshot, is 3 MB."""
MAX_VALUES_PER_S, MAX_VALUES_AT_ONCE = 100.0, 40_000.0
"""Stored readings and parameters: twice what a worker polls at 9600 baud, and all that it keeps at once."""


@dataclass(slots=True)
class FeedQuota:
    """What comes for one bus, over all connections of its workers."""

    _updates: Bucket = field(default_factory=partial(Bucket, PER_S, MAX_AT_ONCE))
    _bytes: Bucket = field(default_factory=partial(Bucket, MAX_BYTES_PER_S, MAX_BYTES_AT_ONCE))
    _values: Bucket = field(default_factory=partial(Bucket, MAX_VALUES_PER_S, MAX_VALUES_AT_ONCE))

    def pause_s(self, message: WorkerMessage, size: int, now: Monotonic) -> float:
        """Count a message of ``size`` bytes; for how many seconds nothing more is read."""
        return max(self._updates.pour(cost_of(message), now), self._bytes.pour(size, now))

    def admits(self, update: Update, now: Monotonic) -> bool:
        """Count an update to be stored; False where a wire cannot have carried it."""
        match update:
            case Reading() | ParameterValue():
                return self._values.take(now)
            case UnitLink() | BusLink():
                return self._values.take(now, TEXT_COST)
        return True


def cost_of(message: WorkerMessage) -> float:
    """What a message costs the app, in updates of the live state."""
    match message:
        case Batch(updates=updates, live=True):
            return 1.0 + sum(map(_cost_of_update, updates))
        case Batch(updates=updates):
            return 1.0 + LATE_COST * len(updates)
        case Snapshot(units=units):
            return TEXT_COST + sum(2 + len(unit.parameters) / 8 for unit in units)
    return 1.0


def _cost_of_update(update: Update) -> float:
    match update:
        case Frames(frames=frames):
            return float(len(frames))
        case BusFigures(units=units):
            return TEXT_COST + len(units) / 8
        case UnitLink() | BusLink():
            return TEXT_COST
    return 1.0
