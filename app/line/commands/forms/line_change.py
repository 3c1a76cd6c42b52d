"""The change of several units of a bus: its review, and the result per unit.

The form of such a review holds for each unit ``raw-N``, the new setpoint, ``was-N``, the one that the person
saw, both raw, the latter empty where it was not known, and ``scale-N``, what both were shown with.
``leave-out`` are the units that the person leaves out by name, as they cannot take it now.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from starlette.datastructures import FormData
from starlette.responses import Response

from app.core.web.shape import parse_integer
from app.errors import Problem
from app.line.commands.forms.page_context import BusPage
from app.line.commands.review import OutcomeText, outcome_text, present_setpoint
from app.line.commands.values import Scales, parse_scale, setpoint_message
from app.line.live.bus_live import BusLive, follower
from bus.contract import Result
from bus.messages import Message, joined


def left_out_of(form: FormData) -> set[int]:
    """The units that the person leaves out. Raises Problem 422 for what is no address."""
    units = {parse_integer(str(text)) for text in form.getlist("leave-out")}
    if None in units:
        raise Problem(422, "invalid", Message("not_what_was_reviewed"))
    return {unit for unit in units if unit is not None}


def reviewed(live: BusLive, form: FormData, *, is_sent: bool) -> tuple[dict[int, int], Scales]:
    """The new setpoints, raw, by address, of the units that are not left out, and what they were shown with.
    Raises Problem 409 where one has moved since the review; ``is_sent``: by this change itself, whose form is
    here again."""
    setpoints, scales, left_out = {}, {}, left_out_of(form)
    for number, unit in live.units.items():
        text = str(form.get(f"raw-{number}", ""))
        if not text or number in left_out:
            continue
        raw = parse_integer(text, 6)
        if raw is None:
            raise Problem(422, "invalid", Message("not_what_was_reviewed"))
        present = present_setpoint(live, unit)
        was = str(form.get(f"was-{number}", ""))
        if not is_sent and was != ("" if present is None else str(present)):
            raise Problem(409, "moved", Message.of("setpoint_of_moved", name=unit.settings.name))
        setpoints[number], scales[number] = raw, parse_scale(form.get(f"scale-{number}"))
    return setpoints, scales


def followers_of(live: BusLive) -> set[int]:
    """The units whose setpoint is a ratio, of which the screen has no live value."""
    return {number for number, unit in live.units.items() if follower(unit)}


def proven(
    page: BusPage,
    title: str,
    setpoints: Mapping[int, int],
    result: Result,
    id: str,
    left_out: Collection[int],
) -> Response:
    """The outcome of each unit in floor order, then those that were left out, and the undo of the change with
    this id."""
    by_unit, units = {outcome.unit: outcome for outcome in result.units}, page.bus.units
    proofs: list[tuple[str | Message, str | Message, OutcomeText]] = [
        (
            units[number].settings.name,
            setpoint_message(raw, units[number]),
            page.outcome(by_unit.get(number, result), number),
        )
        for number, raw in setpoints.items()
    ]
    proofs += [(page.name_of(unit), "", page.outcome_left_out(unit)) for unit in sorted(left_out)]
    return page.render(
        "setpoints/_done.html",
        title=title,
        bus=page.name,
        outcome=_outcome_of_all(result, len(setpoints)),
        proofs=proofs,
        undo=page.undo(id),
        skew=None if result.skew_s is None else page.translator.formats.number(result.skew_s * 1000),
    )


def _outcome_of_all(result: Result, units: int) -> OutcomeText:
    """The outcome of the change: how many of its units are verified."""
    outcome = outcome_text(result)
    if result.outcome == "verified":
        return OutcomeText("good", Message.of("result_of_all", n=units))
    if result.outcome != "unverified":
        return outcome
    good = sum(unit.outcome == "verified" for unit in result.units)
    counted = Message.of("result_of_some", n=units, good=good)
    return OutcomeText(outcome.tone, joined((counted, outcome.text)) or counted)
