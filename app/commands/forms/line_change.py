"""The change of several units of a bus: its review, and the result per unit.

The form of such a review holds for each unit ``raw-N``, the new setpoint, and ``was-N``, the one that the
person saw; both raw, the latter empty where it was not known.
"""

from __future__ import annotations

from collections.abc import Mapping

from starlette.datastructures import FormData
from starlette.responses import Response

from app.commands.forms.outcome import OutcomeText, ResultRow
from app.commands.forms.page_context import PageContext
from app.commands.review.ramp import present_setpoint
from app.errors import Problem
from app.live.state.bus_live import BusLive, follower
from bus.contract import Result
from bus.messages import Message


def reviewed(live: BusLive, form: FormData) -> dict[int, int]:
    """The new setpoints, raw, by address. Raises Problem 409 where one has moved since the review."""
    setpoints = {}
    for number, unit in live.units.items():
        text = str(form.get(f"raw-{number}", ""))
        if not text:
            continue
        if not text.isdecimal() or len(text) > 6:
            raise Problem(422, "invalid", Message("not_what_was_reviewed"))
        present = present_setpoint(live, unit)
        if str(form.get(f"was-{number}", "")) != ("" if present is None else str(present)):
            raise Problem(409, "moved", Message.of("setpoint_of_moved", name=unit.settings.name))
        setpoints[number] = int(text)
    return setpoints


def followers_of(live: BusLive) -> set[int]:
    """The units whose setpoint is a ratio, of which the screen has no live value."""
    return {number for number, unit in live.units.items() if follower(unit)}


def proven(
    page: PageContext, bus: str, title: str, setpoints: Mapping[int, int], result: Result, form: FormData
) -> Response:
    """The outcome of each unit, and the way back where all of them are verified."""
    live = page.bus(bus)
    proofs = _proofs(page, live, setpoints, result)
    return page.render(
        "setpoints/_done.html",
        title=title,
        bus=bus,
        outcome=_outcome_of_all(page, result, proofs),
        proofs=proofs,
        former=_former(page, live, setpoints, form) if result.outcome == "verified" else {},
        skew=None if result.skew_s is None else page.translator.formats.number(result.skew_s * 1000),
    )


def _former(page: PageContext, live: BusLive, setpoints: Mapping[int, int], form: FormData) -> dict[int, str]:
    """What each unit had before, as it shows it; nothing where that is not known of all."""
    was = {number: str(form.get(f"was-{number}", "")) for number in setpoints}
    if not all(text.isdecimal() for text in was.values()):
        return {}
    return {number: page.setpoint(int(text), live.units[number]) for number, text in was.items()}


def _outcome_of_all(page: PageContext, result: Result, proofs: list[ResultRow]) -> OutcomeText:
    """The outcome of the change: how many of its units are verified."""
    outcome = page.outcome(result)
    if result.outcome == "verified":
        return OutcomeText(
            "good", page.translator.tn("verified", "verified at each of {n} units", len(proofs))
        )
    if result.outcome != "unverified":
        return outcome
    proven = sum(unit.outcome == "verified" for unit in result.units)
    counted = page.translator.tn(
        "{good} of {n} unit verified", "{good} of {n} units verified", len(proofs), good=proven
    )
    return OutcomeText(outcome.tone, f"{counted}; {outcome.text}")


def _proofs(
    page: PageContext, live: BusLive, setpoints: Mapping[int, int], result: Result
) -> list[ResultRow]:
    """(name, requested, result) of each unit, in floor order."""
    by_unit = {outcome.unit: outcome for outcome in result.units}
    return [
        (
            live.units[number].settings.name,
            page.setpoint(raw, live.units[number]),
            page.outcome(by_unit.get(number, result), live.units[number]),
        )
        for number, raw in setpoints.items()
    ]
