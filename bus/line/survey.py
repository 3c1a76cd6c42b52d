"""A scan of addresses on a bus that is at work, between its polls. Pure procedures (``bus.line.steps``).

The questions and the conclusions are those of ``bus.line.scan``; only the way they are asked is another.
"""

from __future__ import annotations

from collections.abc import Generator

from bus.contract import FoundUnit, Result
from bus.line.proof import ask
from bus.line.roster import Roster
from bus.line.scan import Found, Outcome, Question, examine
from bus.line.steps import Answer, Ask, Fate, Procedure, Step, Tell, Wish
from bus.settings import Dialect

_PLAIN = Dialect()
_DOUBLED = Dialect(checksum_10h="twice")


class _Lost(Exception):
    """There is no link to the bus any more."""


def survey(roster: Roster, first: int, last: int, baud: int, wish: Wish) -> Procedure:
    """Which of the addresses ``first`` to ``last`` answer at ``baud``, the bus's present rate."""
    found: list[FoundUnit] = []
    addresses = range(first, last + 1)
    for done, unit in enumerate(addresses):
        if wish.cancelled:
            return _result(found, f"given up after {done} of {len(addresses)} addresses")
        yield Tell("sent", unit, done, len(addresses))
        try:
            one = yield from _examine(roster, unit, baud)
        except _Lost:
            return _result(found, f"the link to the bus was lost after {done} of {len(addresses)} addresses")
        if one is not None:
            found.append(one.for_contract())
    return _result(found, "")


def _result(found: list[FoundUnit], trouble: str) -> Result:
    return Result(
        id="", at=0.0, outcome="unverified" if trouble else "verified", message=trouble, found=found
    )


def _examine(roster: Roster, unit: int, baud: int) -> Generator[Step, Answer | None, Found | None]:
    examination = examine(unit, baud)
    try:
        question = next(examination)
        while True:
            outcome = yield from _outcome(roster, question)
            question = examination.send(outcome)
    except StopIteration as end:
        found: Found | None = end.value
        return found


def _outcome(roster: Roster, question: Question) -> Generator[Step, Answer | None, Outcome]:
    """One question as the bus asks it. A second copy shows as one more late frame of that unit."""
    statistics = roster[question.request.unit].statistics
    late = statistics.late
    dialect = _DOUBLED if question.doubled else _PLAIN
    answer = yield from ask(Ask(question.request, most_tries=1, dialect=dialect))
    if answer.fate is Fate.CLOSED:
        raise _Lost
    return Outcome(
        reply=answer.reply,
        spoilt=answer.rubbish.spoilt,
        strange=answer.rubbish.strange,
        twice=statistics.late > late,
    )
