"""The exchange under way: its times, and what came in beside its response."""

from __future__ import annotations

import asyncio

import msgspec

from bus.instants import Monotonic
from bus.line.clock import LineClock
from bus.line.exchange.send import NO_NOISE, ExchangeResult, LineNoise
from bus.wire.exchange import Exchange


class CurrentExchange(msgspec.Struct):
    """Times are the line's own, in seconds."""

    exchange: Exchange
    began: Monotonic
    ends_sending: Monotonic
    """When the request's last byte has left."""
    last_moment: Monotonic
    """No response can come later, whenever this process receives it."""
    ending: asyncio.Future[ExchangeResult]
    """How it ended, once it has."""
    garbled: bool = False
    unexpected: bool = False
    unrequested: bool = False
    """Whether a unit responded to what this host has not requested."""
    late: int = 0
    overdue: tuple[int, ...] = ()

    @property
    def has_noise(self) -> bool:
        """Whether anything came in beside the response."""
        return self.garbled or self.unexpected or self.late > 0

    def result(self, clock: LineClock, ended: Monotonic) -> ExchangeResult:
        """Return how the exchange ended at ``ended``."""
        exchange = self.exchange
        responded_at = clock.epoch(min(ended, self.last_moment)) if exchange.reply is not None else None
        # Bytes that never became a frame are noise too: two units at one address may sound like that.
        garbled = self.garbled or (exchange.reply is None and exchange.first_byte_at is not None)
        return ExchangeResult(
            exchange.request,
            exchange.reply,
            self.began,
            ended,
            clock.epoch(self.ends_sending),
            responded_at,
            b"" if exchange.secret else exchange.frame,
            LineNoise(garbled, self.unexpected, self.late) if garbled or self.has_noise else NO_NOISE,
            exchange.dialect,
            self.overdue,
        )
