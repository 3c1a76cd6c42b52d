from __future__ import annotations

import pytest

from app.core.web.admission.arrival import Deadline
from app.errors import Problem
from app.line.commands.forms.outcome import outcome_text
from bus.contract import Result, UnitOutcome
from bus.instants import monotonic_now
from bus.messages import Message, term
from tests.app.screens import translator


@pytest.mark.parametrize(
    ("result", "tone", "text"),
    [
        (Result(id="1", at=0, outcome="verified", read_back=1200), "good", "verified: reads 1200"),
        (Result(id="1", at=0, outcome="verified"), "good", "verified"),
        (Result(id="1", at=0, outcome="acknowledged"), "good", "acknowledged by the unit"),
        (
            Result(id="1", at=0, outcome="refused", unit_error=0x80),
            "bad",
            "rejected by the unit: unit is not in REMOTE mode",
        ),
        (Result(id="1", at=0, outcome="unverified", read_back=1198), "unknown", "reads 1198 instead"),
        (
            Result(id="1", at=0, outcome="unverified"),
            "unknown",
            "no response: the result is not known",
        ),
        (Result(id="1", at=0, outcome="not_sent"), "bad", ("not sent: the bus was busy until the deadline")),
        (Result(id="1", at=0, outcome="bus_closed"), "bad", "not sent: there is no link to the bus"),
        (Result(id="1", at=0, outcome="invalid", message=term("no")), "bad", "no"),
    ],
)
def test_every_outcome_has_its_words(result: Result, tone: str, text: str) -> None:
    outcome = outcome_text(result)
    assert (outcome.tone, str(outcome.text)) == (tone, text)


def test_a_withdrawn_part_of_a_change_is_shown_in_the_reader_s_language() -> None:
    taken_back = Message.of("staged_withdrawn", present=1200)
    part = UnitOutcome(unit=3, outcome="not_sent", message=taken_back)
    assert outcome_text(part).text == taken_back
    assert "vorbereitet; nicht ausgeführt" in translator("de").t(outcome_text(part).text)


def test_a_refusal_before_sending_is_shown_in_the_reader_s_language() -> None:
    with pytest.raises(Problem) as late:
        Deadline(monotonic_now() - 4, 2.0).refuse_passed()
    text = translator("de").t(late.value.message)
    assert text.startswith("der Befehl kam zu spät: er ist 4,0 s alt, erlaubt waren 2 s")
