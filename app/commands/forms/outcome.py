"""What became of a wish, in the words of the screen. Pure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from app.errors import Problem
from app.live.screen.fields import Translator
from bus.contract import Outcome, Result, UnitOutcome
from bus.errors import unit_error
from bus.messages import Message

Tone = Literal["good", "bad", "unknown"]
ValueFormat = Callable[[int], str]
"""A read-back integer as people read it."""


_OF_A_PART: dict[Outcome, Tone] = {"not_sent": "bad", "unverified": "unknown"}
"""Where one unit's part in a change has an end of its own, told by its message: taken back, or still held."""


@dataclass(frozen=True, slots=True)
class OutcomeText:
    """``good`` it is so; ``bad`` it is not, and nothing is half done; ``doubt`` nobody knows."""

    tone: Tone
    text: str


ResultRow = tuple[str, str, OutcomeText]
"""A unit's name, the requested value and the result."""


def outcome_text(result: Result | UnitOutcome, shown: ValueFormat, voice: Translator) -> OutcomeText:
    """The fate of a command, or of one unit's part in it."""
    read = "" if result.read_back is None else shown(result.read_back)
    if isinstance(result, UnitOutcome) and result.message and not read and result.outcome in _OF_A_PART:
        return OutcomeText(_OF_A_PART[result.outcome], voice.t(result.message))
    match result.outcome:
        case "verified":
            said = voice.t("verified: reads {value}", value=read) if read else voice.t("verified")
            return OutcomeText("good", said)
        case "acknowledged":
            return OutcomeText("good", voice.t("acknowledged by the unit"))
        case "refused":
            return OutcomeText(
                "bad", voice.t("rejected by the unit: {reason}", reason=_reason(result, voice))
            )
        case "unverified":
            if read:
                return OutcomeText("unknown", voice.t("reads {value} instead", value=read))
            return OutcomeText("unknown", voice.t("no response: the result is not known"))
    return OutcomeText("bad", _not_sent(result.outcome, result.message, voice))


def problem_text(problem: Problem, voice: Translator) -> OutcomeText:
    """What was refused before anything was sent."""
    return OutcomeText("bad", voice.t(problem.message))


def _reason(result: Result | UnitOutcome, voice: Translator) -> str:
    if result.unit_error is not None:
        return voice.t(unit_error(result.unit_error))
    return voice.t(result.message or "")


def _not_sent(outcome: Outcome, message: Message | None, voice: Translator) -> str:
    if outcome == "not_sent":
        return voice.t("not sent: the bus was busy until the deadline")
    if outcome == "bus_closed":
        return voice.t("not sent: there is no link to the bus")
    return voice.t(message or "")
