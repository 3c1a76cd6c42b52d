"""The exchange under way: its times, and what came in beside its response."""

from __future__ import annotations

import asyncio

import msgspec

from bus.line.clock import LineClock
from bus.line.exchange.send import NO_NOISE, LineNoise
from bus.line.exchange.send_attempts import ExchangeResult
from bus.wire.exchange import Exchange


class CurrentExchange(msgspec.Struct):
    """Times are the line's own, in seconds."""

    exchange: Exchange
    response: asyncio.Future[ExchangeResult]
    began: float
    ends_sending: float
    """When the request's last byte has left."""
    last_moment: float
    """No response can come later, whenever this process receives it."""
    frame: bytes = b""
    """The response, as it was on the wire."""
    garbled: bool = False
    unexpected: bool = False
    late: int = 0
    overdue: tuple[int, ...] = ()

    def end(self, clock: LineClock, now: float) -> None:
        """It ends as it is at ``now``; nothing awaits the result once the worker ends."""
        if not self.response.done():
            self.response.set_result(self._result(clock, now))

    def _result(self, clock: LineClock, now: float) -> ExchangeResult:
        exchange = self.exchange
        responded_at = clock.epoch(min(now, self.last_moment)) if exchange.reply is not None else None
        return ExchangeResult(
            exchange.request,
            exchange.reply,
            self.began,
            now,
            clock.epoch(self.ends_sending),
            responded_at,
            b"" if exchange.prepared.secret else self.frame,
            self._noise(),
            exchange.dialect,
            self.overdue,
        )

    def _noise(self) -> LineNoise:
        """Bytes that never became a frame are noise too: two units at one address may sound like that."""
        exchange = self.exchange
        garbled = self.garbled or (exchange.reply is None and exchange.first_byte_at is not None)
        if not (garbled or self.unexpected or self.late):
            return NO_NOISE
        return LineNoise(garbled, self.unexpected, self.late)
