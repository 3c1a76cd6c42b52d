"""The result of a command in the words of the screen. Pure."""

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
"""Where one unit's part of a change has its own outcome, given by its message: reverted, or still staged."""


@dataclass(frozen=True, slots=True)
class OutcomeText:
    """``good``: as requested; ``bad``: not so, and nothing is half done; ``unknown``: not known."""

    tone: Tone
    text: str


ResultRow = tuple[str, str, OutcomeText]
"""A unit's name, the requested value and the result."""


def outcome_text(result: Result | UnitOutcome, shown: ValueFormat, translator: Translator) -> OutcomeText:
    """The text of the result of a command, or of one unit's part in it."""
    read = "" if result.read_back is None else shown(result.read_back)
    if isinstance(result, UnitOutcome) and result.message and not read and result.outcome in _OF_A_PART:
        return OutcomeText(_OF_A_PART[result.outcome], translator.t(result.message))
    match result.outcome:
        case "verified":
            text = translator.t("verified: reads {value}", value=read) if read else translator.t("verified")
            return OutcomeText("good", text)
        case "acknowledged":
            return OutcomeText("good", translator.t("acknowledged by the unit"))
        case "refused":
            return OutcomeText(
                "bad", translator.t("rejected by the unit: {reason}", reason=_reason(result, translator))
            )
        case "unverified":
            if read:
                return OutcomeText("unknown", translator.t("reads {value} instead", value=read))
            return OutcomeText("unknown", translator.t("no response: the result is not known"))
    return OutcomeText("bad", _not_sent(result.outcome, result.message, translator))


def problem_text(problem: Problem, translator: Translator) -> OutcomeText:
    """What was refused before anything was sent."""
    return OutcomeText("bad", translator.t(problem.message))


def _reason(result: Result | UnitOutcome, translator: Translator) -> str:
    if result.unit_error is not None:
        return translator.t(unit_error(result.unit_error))
    return translator.t(result.message or "")


def _not_sent(outcome: Outcome, message: Message | None, translator: Translator) -> str:
    if outcome == "not_sent":
        return translator.t("not sent: the bus was busy until the deadline")
    if outcome == "bus_closed":
        return translator.t("not sent: there is no link to the bus")
    return translator.t(message or "")
