"""The result of a command as a page shows it. Pure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from bus.contract import Outcome, Result, UnitOutcome
from bus.errors import unit_error
from bus.messages import Message

Tone = Literal["good", "bad", "unknown"]
ValueFormat = Callable[[int], str | Message]
"""A read-back integer as people read it."""
_OF_A_PART: dict[Outcome, Tone] = {"not_sent": "bad", "unverified": "unknown"}
"""Where one unit's part of a change has its own outcome, given by its message: reverted, or still staged."""


@dataclass(frozen=True, slots=True)
class OutcomeText:
    """``good``: as requested; ``bad``: not so, and nothing is half done; ``unknown``: not known."""

    tone: Tone
    text: Message


ResultRow = tuple[str, str | Message, OutcomeText]
"""A unit's name, the requested value and the result."""


def outcome_text(result: Result | UnitOutcome, shown: ValueFormat = str) -> OutcomeText:
    """The text of the result of a command, or of one unit's part in it."""
    message = result.message
    if message and message.code == "scale_changed_since":
        return OutcomeText("unknown", message)
    if message and result.outcome == "refused" and result.unit_error is None:
        # Before anything was sent: no unit has rejected it.
        return OutcomeText("bad", message)
    return _outcome_text(result, shown)


def _outcome_text(result: Result | UnitOutcome, shown: ValueFormat) -> OutcomeText:
    message = result.message
    if (
        isinstance(result, UnitOutcome)
        and message
        and result.read_back is None
        and result.outcome in _OF_A_PART
    ):
        return OutcomeText(_OF_A_PART[result.outcome], message)
    match result.outcome, result.read_back:
        case "verified", None:
            return OutcomeText("good", Message("result_verified"))
        case "verified", int(read):
            return OutcomeText("good", Message.of("result_reads", value=shown(read)))
        case "acknowledged", _:
            return OutcomeText("good", Message("result_acknowledged"))
        case "unverified", None:
            return OutcomeText("unknown", Message("result_no_response"))
        case "unverified", int(read):
            return OutcomeText("unknown", Message.of("result_reads_other", value=shown(read)))
        case "refused", _:
            reason = "" if result.unit_error is None else unit_error(result.unit_error)
            return OutcomeText("bad", Message.of("result_refused", reason=reason))
        case "not_sent", _:
            return OutcomeText("bad", Message("result_not_sent"))
        case "bus_closed", _:
            return OutcomeText("bad", Message("result_bus_closed"))
    return OutcomeText("bad", message or Message("outcome_invalid"))
