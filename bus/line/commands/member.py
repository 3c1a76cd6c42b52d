"""One unit of a change of many, from its stage to its outcome."""

from __future__ import annotations

from dataclasses import dataclass

from bus.contract import UnitOutcome
from bus.line.exchange.send import SendResult, SendStatus
from bus.line.roster import UnitRecord


@dataclass(slots=True)
class Member:
    """One unit of a change."""

    record: UnitRecord
    raw: int
    before: int | None = None
    sent: SendResult | None = None
    outcome: UnitOutcome | None = None

    @property
    def unit(self) -> int:
        """Its address."""
        return self.record.unit

    @property
    def staged(self) -> bool:
        """Whether it acknowledged the stage of this very change."""
        return (
            self.sent is not None and self.sent.status is SendStatus.RESPONDED and self.sent.refusal is None
        )

    @property
    def may_hold(self) -> bool:
        """Whether its memory may hold the value: it was sent, and not surely refused."""
        return self.sent is not None and self.sent.may_have_acted


def member_of(record: UnitRecord, raw: int) -> Member:
    """``record`` is to take ``raw``; ``before`` is what it was last seen commanded."""
    return Member(record, raw, record.reading.commanded if record.reading is not None else None)
