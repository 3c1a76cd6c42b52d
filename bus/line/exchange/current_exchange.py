"""The exchange under way: its times, and what came in beside its answer."""

from __future__ import annotations

import msgspec

from bus.line.clock import Clock
from bus.line.commands.procedure import NO_RUBBISH, Rubbish
from bus.line.exchange.attempts import Heard
from bus.wire.exchange import Exchange


class UnderWay(msgspec.Struct):
    """Times are the line's own, in seconds."""

    exchange: Exchange
    began: float
    ends_sending: float
    """When the request's last byte has left."""
    last_moment: float
    """No answer can come later, whenever this process gets to hear it."""
    frame: bytes = b""
    """The answer, as it was on the wire."""
    spoilt: bool = False
    strange: bool = False

    def heard(self, clock: Clock, now: float) -> Heard:
        """How it ended, at ``now``."""
        exchange = self.exchange
        answered_at = clock.epoch(min(now, self.last_moment)) if exchange.reply is not None else None
        return Heard(
            exchange.request,
            exchange.reply,
            clock.epoch(self.ends_sending),
            answered_at,
            b"" if exchange.prepared.secret else self.frame,
            self._rubbish(),
            exchange.dialect,
        )

    def _rubbish(self) -> Rubbish:
        """Bytes that never became a frame are rubbish too: two units at one address may sound like that."""
        exchange = self.exchange
        spoilt = self.spoilt or (exchange.reply is None and exchange.first_byte_at is not None)
        return Rubbish(spoilt, self.strange) if spoilt or self.strange else NO_RUBBISH
