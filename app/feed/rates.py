"""How much a worker may send. Pure.

Nothing is dropped: input over the rate is not read yet, and waits in the worker's own buffer. A worker
that polls 255 units at 9600 baud, and is followed, sends a tenth of this.
"""

from __future__ import annotations

from bus.bucket import Bucket
from bus.contract import (
    Batch,
    BusFigures,
    BusLink,
    Frames,
    Snapshot,
    UnitLink,
    Update,
    WorkerMessage,
)

PER_S = 2_000.0
"""Updates of the live state, each of which goes to every open page."""
AT_ONCE = 10_000.0
"""A complete snapshot, or the backlog of a quarter of an hour."""
LATE_COST = 0.25
"""Of an update that goes to history only."""
TEXT_COST = 40.0
"""Of a state with its cause, or a diagnosis: the text is translated for each language."""
HELLOS_PER_S, HELLOS_AT_ONCE = 0.5, 20.0


def update_bucket() -> Bucket:
    """What the updates of one bus are measured by."""
    return Bucket(PER_S, AT_ONCE)


def hello_bucket() -> Bucket:
    """What the connections by one token are measured by."""
    return Bucket(HELLOS_PER_S, HELLOS_AT_ONCE)


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
            return TEXT_COST if update.cause else 1.0
    return 1.0
