"""A message to one address from the outbox to its end, and which is next. Pure: the time is passed in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from bus.errors import LinesideError
from bus.instants import UnixTime

DeliveryState = Literal["sending", "retrying", "delivered", "failed", "canceled"]
"""A delivery begins as ``sending``, on disk before the first byte leaves. Where the server ends in between,
whether the message left is not known: it is ``retrying``, with the same id. ``canceled``: its address is not
configured any more. What is delivered, failed or canceled never leaves again."""
FIRST_RETRY_S = 5.0
MAX_RETRY_S = 900.0
GIVE_UP_S = 86_400.0
FLOOD_WINDOW_S = 600.0
GATHER_S = 3.0
"""For which the alarms that stood at a start are gathered, those of all buses in one message."""
FAILING_ATTEMPTS = 2
"""So many failures without a success between are no chance: the address is failing."""


class NotDeliveredError(LinesideError):
    """Why a message was not delivered, in words without any secret."""


def retry_after_s(attempts: int) -> float:
    """The time up to the next attempt after so many: 5, 10, 20 … seconds, at most 15 minutes."""
    return min(MAX_RETRY_S, FIRST_RETRY_S * 2.0 ** min(attempts - 1, 20))


def state_after_failure(created_at: UnixTime, now: UnixTime) -> DeliveryState:
    """A message is given up after a day."""
    return "failed" if now - created_at >= GIVE_UP_S else "retrying"


@dataclass(frozen=True, slots=True)
class Retry:
    """A delivery that is tried again at ``due``."""

    id: int
    attempts: int
    due: UnixTime

    def wait_s(self, now: UnixTime) -> float:
        """A wait longer than any backoff is one of a clock that was set back: it is over."""
        wait_s = self.due - now
        return wait_s if 0 < wait_s <= MAX_RETRY_S else 0.0


@dataclass(frozen=True, slots=True)
class EndpointLoad:
    """What there is for one address. ``items``: not in any message yet, oldest first, and since when;
    ``sent``: when the last messages left; ``standing``: as ``items``, those that stood at a start."""

    items: Sequence[tuple[int, UnixTime]]
    retries: Sequence[Retry]
    sent: Sequence[UnixTime]
    collects: bool = True
    """Whether several items may be one message: people read a digest, programs want each."""
    standing: Sequence[tuple[int, UnixTime]] = ()


@dataclass(frozen=True, slots=True)
class DeliveryTurn:
    """``items``: to be sent as one message; else ``retry``: the delivery to be tried; else ``wait_s``."""

    items: tuple[int, ...] = ()
    retry: int | None = None
    wait_s: float | None = None
    """None: until there is something to send."""


def next_turn(load: EndpointLoad, flood: int, digest_s: float, now: UnixTime) -> DeliveryTurn:
    """What follows for an address. New items go first, so that one refused message holds up no other."""
    waits: list[float] = []
    if load.items:
        wait_s = _digest_wait_s(load, flood, digest_s, now)
        if wait_s <= 0:
            return DeliveryTurn(items=_first_items(load, flood, now))
        waits.append(wait_s)
    if load.standing:
        wait_s = _wait_s(GATHER_S, load.standing[0][1], now)
        if wait_s <= 0:
            return DeliveryTurn(items=tuple(item for item, _ in load.standing))
        waits.append(wait_s)
    due = [retry for retry in load.retries if not retry.wait_s(now)]
    if due:
        return DeliveryTurn(retry=min(due, key=lambda retry: (retry.attempts, retry.id)).id)
    waits += [retry.wait_s(now) for retry in load.retries]
    return DeliveryTurn(wait_s=min(waits, default=None))


def is_flooded(load: EndpointLoad, flood: int, now: UnixTime) -> bool:
    """Whether further items are collected: many messages in ten minutes, or an address that is failing."""
    recent = [at for at in load.sent if 0 <= now - at < FLOOD_WINDOW_S]
    return load.collects and (len(recent) >= flood or bool(load.retries))


def heartbeat_due(before: datetime, now: datetime, minute_of_day: int) -> str:
    """The day of the heartbeat, the daily proof that the path works, whose local time has come since
    ``before``; empty where none has."""
    at = now.replace(hour=minute_of_day // 60, minute=minute_of_day % 60, second=0, microsecond=0)
    return now.date().isoformat() if before < at <= now else ""


def _digest_wait_s(load: EndpointLoad, flood: int, digest_s: float, now: UnixTime) -> float:
    if not is_flooded(load, flood, now):
        return 0.0
    return _wait_s(digest_s, load.items[0][1], now)


def _wait_s(wait_s: float, since: UnixTime, now: UnixTime) -> float:
    """The rest of a wait. Where the clock was set back since it began, it is over."""
    return wait_s - (now - since) if now >= since else 0.0


def _first_items(load: EndpointLoad, flood: int, now: UnixTime) -> tuple[int, ...]:
    several = is_flooded(load, flood, now)
    return tuple(item for item, _ in (load.items if several else load.items[:1]))
