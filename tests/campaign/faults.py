"""What goes wrong in a campaign, and when: from a seed, before anything runs. Pure."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

Kind = Literal["kill", "stop", "kill_worker", "stop_worker", "cut", "separate", "clock"]
SERVER, DEVICE = "app", "device"
SETTLE_S = 6.0
"""Least time after a fault until the next."""
LONGEST_S = 8.0
_CHOICES: tuple[tuple[int, Kind, str], ...] = (
    (3, "kill", SERVER),
    (3, "cut", SERVER),
    (3, "stop", SERVER),
    (3, "kill_worker", SERVER),
    (3, "stop_worker", SERVER),
    (2, "separate", SERVER),
    (1, "clock", SERVER),
    (2, "kill", DEVICE),
    (2, "stop", DEVICE),
)
"""How often relative to the others, what, to which machine."""


@dataclass(frozen=True)
class Fault:
    """``kind`` happens to ``target`` for ``lasts_s``, once the fault before it has been over for ``after_s``.

    ``step_s``: how far ``clock`` moves its clock. ``separate`` separates the server from the device server.
    """

    after_s: float
    kind: Kind
    target: str
    lasts_s: float
    step_s: float = 0.0


def schedule(seed: int, count: int) -> Iterator[Fault]:
    """``count`` faults, one after the other; the same seed gives the same ones."""
    chance = random.Random(seed)
    weights = [weight for weight, *_ in _CHOICES]
    for _ in range(count):
        ((_, kind, target),) = chance.choices(_CHOICES, weights)
        yield Fault(
            round(chance.uniform(SETTLE_S, 2 * SETTLE_S), 2),
            kind,
            target,
            round(chance.uniform(0.5, LONGEST_S), 2),
            chance.choice((-3600.0, -40.0, -3.0, 3.0, 40.0, 3600.0)) if kind == "clock" else 0.0,
        )
