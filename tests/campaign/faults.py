"""What goes wrong in a campaign, and when: from a seed, before anything runs. Pure."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

Kind = Literal["kill", "stop", "kill_worker", "stop_worker", "cut", "separate", "clock", "fail_over"]
SETTLE_S = 8.0
"""Least time after a fault until the next: a server that is back has watched a lease for five seconds."""
TAKE_OVER_S = 14.0
"""How long a server is gone whose lines another has to take over within ten seconds."""


@dataclass(frozen=True)
class Fault:
    """``kind`` happens to ``target`` for ``lasts_s``, once the fault before it has been over for ``after_s``.

    ``other``: from which machine ``separate`` separates it. ``step_s``: how far ``clock`` moves its clock.
    ``fail_over`` is of the machine that has the primary database then.
    """

    after_s: float
    kind: Kind
    target: str
    lasts_s: float
    other: str = ""
    step_s: float = 0.0

    @property
    def takes_a_holder(self) -> bool:
        """Whether the other server has to take over what this one has, in the time that it lasts."""
        return self.kind in ("kill", "cut") and self.target in SERVERS and self.lasts_s >= TAKE_OVER_S


SERVERS = frozenset(("app-1", "app-2"))
DEVICE = frozenset(("device",))
LONG, SHORT = (TAKE_OVER_S, 20.0), (0.5, 8.0)
_CHOICES: tuple[tuple[int, Kind, frozenset[str], tuple[float, float]], ...] = (
    (4, "kill", SERVERS, LONG),
    (2, "cut", SERVERS, LONG),
    (3, "stop", SERVERS, SHORT),
    (2, "cut", SERVERS, SHORT),
    (2, "kill_worker", SERVERS, SHORT),
    (2, "stop_worker", SERVERS, SHORT),
    (2, "separate", SERVERS, SHORT),
    (1, "clock", SERVERS, SHORT),
    (1, "kill", DEVICE, SHORT),
    (1, "stop", DEVICE, SHORT),
)
"""How often relative to the others, what, to one of these, for how long."""
_SEPARATED_FROM = frozenset(("device", "app-1", "app-2"))


def schedule(seed: int, count: int, machines: frozenset[str]) -> Iterator[Fault]:
    """``count`` faults of these machines, one after the other; the same seed gives the same ones."""
    chance = random.Random(seed)
    choices = [choice for choice in _CHOICES if machines & choice[2]]
    weights = [weight for weight, *_ in choices]
    for _ in range(count):
        ((_, kind, targets, lasts),) = chance.choices(choices, weights)
        target = chance.choice(sorted(targets & machines))
        others = sorted(_SEPARATED_FROM & machines - {target}) if kind == "separate" else [""]
        yield Fault(
            round(chance.uniform(SETTLE_S, 1.5 * SETTLE_S), 2),
            kind,
            target,
            round(chance.uniform(*lasts), 2),
            chance.choice(others),
            chance.choice((-3600.0, -40.0, -3.0, 3.0, 40.0, 3600.0)) if kind == "clock" else 0.0,
        )
