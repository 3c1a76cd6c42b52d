"""Batch edits: one parameter of many units, reviewed as a table, written unit by unit; and the page."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Annotated

from fastapi import APIRouter, Form, Request, Response
from starlette.datastructures import FormData

from app.core.web.access import Person
from app.core.web.arrival import Deadline
from app.core.web.routes import GuardedRoute
from app.core.web.shape import parse_integer
from app.engineering.sets.model import UnitRows, known_rows, status_of, with_unit
from app.errors import Problem
from app.line.commands.effects import OPERATING_VALUES, effect_message, warning_of
from app.line.commands.limits import Limits
from app.line.commands.page_context import BusPage, Confirmed, PageOfBus
from app.line.commands.pages.unit import CONFIRMING_WORD
from app.line.commands.review import (
    OutcomeText,
    Tone,
    by_remark,
    failed_units,
    parameter_outcome,
    refused_parameter,
)
from app.line.commands.rules import objection
from app.line.commands.service import CommandService, ParameterWriter
from app.line.commands.values import parameter_message, parameter_scale
from app.line.live.bus_live import BusLive, UnitLive, is_driven
from bus.catalogue.parameters import (
    DECIMALS,
    FOLLOWER_MODE,
    PARAMETERS,
    Parameter,
    Scale,
    nearest_legal,
)
from bus.catalogue.values import StatusBits, is_follower, parameter_raw
from bus.contract import ReadParameters, Result, UnitScale, WriteParameter
from bus.errors import CallerError
from bus.instants import UnixTime
from bus.messages import Message, joined

_OF_THE_PERSON = frozenset({"forbidden", "rights_withdrawn", "controlled"})
"""The refusals that would also meet every other unit."""
_LEARN_WITHIN_S = 10.0
"""The seconds to read one parameter of 255 units: 5 s at 9600 baud, twice that beside the scan."""


@dataclass(frozen=True, slots=True)
class BatchRow:
    """A unit of a batch, with the text that was ``typed`` for it.

    ``wanted``: the raw value to write, if any; ``fault``: the reason why the text is refused, and
    ``nearest`` what is not; ``warning``: the effect of the write on the machine now.
    """

    unit: int
    name: str
    present: Message
    present_raw: int | None
    reviewed: str = ""
    """The raw present value in a form, to detect a change; empty for a secret or unknown value."""
    typed: str = ""
    wanted: int | None = None
    scale: UnitScale = field(default_factory=dict)
    """The scale that converted ``typed``."""
    shown: Message | None = None
    fault: Message | None = None
    nearest: Message | str = ""
    warning: Message | None = None

    @property
    def changes(self) -> bool:
        """Whether there is a value to write that the unit does not have."""
        return self.wanted is not None and self.wanted != self.present_raw


@dataclass(frozen=True, slots=True)
class BatchResult:
    """The result at one unit. ``id``: of its command; ``part``: the result, or why nothing was sent."""

    row: BatchRow
    id: str
    part: Result | Problem | Message


@dataclass(frozen=True, slots=True)
class BatchUndo:
    """The undo of a batch, as a page offers it: a batch with the former values, of which ``href`` makes the
    review. The other fields are those of `UndoOffer`."""

    href: str
    values: dict[str, str]
    text: Message
    until: UnixTime
    sets_speed: bool = False


def rows_of_batch(
    bus: BusLive,
    number: int,
    typed: Mapping[int, str],
    limits: Callable[[int], Limits] = lambda _: Limits(),
) -> list[BatchRow]:
    """Return one row for each unit of the bus, with its present value and its typed text. ``limits``: a
    function that returns the limits of a unit, within which another value is offered for a refused one."""
    return [
        _row(unit, PARAMETERS[number], typed.get(key, "").strip(), status_of(bus, unit), limits(key))
        for key, unit in bus.units.items()
    ]


def refuse_moved(rows: Iterable[BatchRow], reviewed: Mapping[int, str]) -> None:
    """Raise Problem 409 if a unit no longer has the value that the review showed.

    ``reviewed``: the :attr:`BatchRow.reviewed` of that time, by unit.
    """
    for row in rows:
        if row.changes and reviewed.get(row.unit, row.reviewed) != row.reviewed:
            raise Problem(409, "moved", Message.of("value_moved", name=row.name))


async def learn(commands: CommandService, person: Person, bus: BusLive, number: int) -> None:
    """Read a parameter of the online units for which it was never read. A unit that does not respond still
    has no value afterwards."""

    async def read(unit: int) -> None:
        action = ReadParameters(unit=unit, numbers=[number], urgent=True)
        with suppress(Problem):
            await commands.send(person, action, deadline=Deadline.within(_LEARN_WITHIN_S))

    unknown = [
        key for key, unit in bus.units.items() if number not in unit.parameters and unit.link.link == "online"
    ]
    await asyncio.gather(*(read(unit) for unit in unknown))


async def write_batch(
    commands: CommandService, person: Person, number: int, rows: list[BatchRow], id: str, *, confirm: bool
) -> list[BatchResult]:
    """Write the changed values of a batch, one unit after another. ``id``: the id of the batch, from which
    each command gets its own. A refusal because of the person ends the batch, one because of a unit does
    not."""
    results: list[BatchResult] = []
    stopped_by: Message | None = None
    for row in rows:
        if not row.changes:
            continue
        key = f"{id}-{row.unit}"
        part = stopped_by or await _write(commands, person, number, row, key, confirm=confirm)
        results.append(BatchResult(row, key, part))
        if isinstance(part, Problem) and part.code in _OF_THE_PERSON:
            stopped_by = part.message
    return results


def _row(
    unit: UnitLive, parameter: Parameter, typed: str, status: StatusBits | None, limits: Limits
) -> BatchRow:
    known = known_rows(unit)
    raw = unit.parameter_raw(parameter.number)
    present = Message("value_not_known") if raw is None else _shown(parameter, raw, known)
    reviewed = "" if raw is None or parameter.secret else str(raw)
    row = BatchRow(unit.settings.id, unit.settings.name, present, raw, reviewed, typed)
    if not typed:
        return row
    try:
        if parameter.scale is Scale.SPEED_OR_RATIO and FOLLOWER_MODE not in unit.parameters:
            raise CallerError(Message.of("unit_mode_unknown", unit=unit.settings.id))
        follower = is_follower(unit.parameter_raw(FOLLOWER_MODE))
        wanted = parameter_raw(parameter, typed, unit.parameter_raw(DECIMALS), follower=follower)
        if (legal := nearest_legal(parameter, wanted)) != wanted:
            raise objection("invalid", Message("out_of_range"), nearest=legal)
    except (CallerError, Problem) as error:
        fault, nearest = refused_parameter(unit, parameter, error, limits)
        return replace(row, fault=fault, nearest=nearest)
    shown = _shown(parameter, wanted, known)
    warning = warning_of(parameter.number, wanted, running=None if status is None else is_driven(status))
    scale = parameter_scale(unit, parameter.number, wanted)
    return replace(row, wanted=wanted, scale=scale, shown=shown, warning=warning)


def _shown(parameter: Parameter, raw: int, known: UnitRows) -> Message:
    return Message("value_hidden") if parameter.secret else with_unit(parameter, raw, known)


async def _write(
    commands: CommandService, person: Person, number: int, row: BatchRow, id: str, *, confirm: bool
) -> Result | Problem:
    action = WriteParameter(unit=row.unit, number=number, raw=row.wanted or 0)
    try:
        return await commands.send(
            person, action, confirm=confirm, id=id, origin="batch edit", scales={row.unit: row.scale}
        )
    except Problem as problem:
        return problem


router = APIRouter(include_in_schema=False, route_class=GuardedRoute)


@router.get("/batch/{bus}")
async def batch_page(person: ParameterWriter, page: PageOfBus, number: int = 6) -> Response:
    """Show the values of one parameter in all units; read those that were never read."""
    parameter = writable_or_404(number)
    await learn(page.commands, person, page.bus, number)
    return page.render(
        "sets/batch.html",
        fields=page.fields(),
        bus=page.name,
        parameter=parameter,
        rows=rows_of_batch(page.bus, number, {}),
        parameters=[each for each in PARAMETERS.values() if not each.never_writable],
    )


@router.post("/batch/{bus}/review")
async def batch_review(request: Request, _: ParameterWriter, page: PageOfBus) -> Response:
    """Show row by row the writes that would be sent, and which units take none and why; send none."""
    number, typed = await typed_batch(request)
    parameter = writable_or_404(number)
    rows = rows_of_batch(page.bus, number, typed, page.guards.limits)
    unable = {row.unit: reason for row in rows if row.typed and (reason := page.obstacle(row.unit))}
    if any(row.fault for row in rows) or not any(row.changes and row.unit not in unable for row in rows):
        return refused_batch(page, parameter, rows)
    return page.review(
        "sets/_batch_review.html",
        bus=page.name,
        parameter=parameter,
        rows=[row for row in rows if row.typed and row.unit not in unable],
        kept=[row for row in rows if row.unit in unable],
        left_out=by_remark((row.name, unable[row.unit]) for row in rows if row.unit in unable),
        danger=effect_message("setpoint") if number in OPERATING_VALUES else parameter.dangerous,
    )


def refused_batch(page: BusPage, parameter: Parameter, rows: list[BatchRow]) -> Response:
    """Render the refusal of a batch, with the reason at the field of each refused value."""
    response = page.render(
        "sets/_batch_refused.html",
        status=422,
        fields=page.fields(),
        bus=page.name,
        parameter=parameter,
        rows=rows,
        typed=any(row.changes for row in rows),
    )
    response.headers["HX-Retarget"] = "#batch-error"
    return response


@router.post("/batch/{bus}/write")
async def batch_write(
    request: Request,
    person: ParameterWriter,
    page: PageOfBus,
    confirmed: Confirmed,
    word: Annotated[str, Form(alias="typed", max_length=20)] = "",
) -> Response:
    """Write the values that the review showed; what was typed for a unit that was left out stays."""
    number, typed = await typed_batch(request)
    parameter = writable_or_404(number)
    rows = rows_of_batch(page.bus, number, typed)
    try:
        if any(row.fault for row in rows):
            raise Problem(422, "invalid", Message("value_not_writable"))
        if parameter.dangerous and word.strip() != CONFIRMING_WORD:
            raise Problem(409, "dangerous", Message("word_not_typed"))
        confirmed.refuse_lapsed()
        form = await request.form()
        refuse_moved(rows, _by_unit(form, "was-"))
    except Problem as problem:
        return page.not_sent(problem)
    confirm = bool(parameter.dangerous)
    results = await write_batch(page.commands, person, number, rows, confirmed.id, confirm=confirm)
    proofs = [(each.row.name, each.row.shown, _outcome(page, each, parameter)) for each in results]
    tones = {outcome.tone for _, _, outcome in proofs}
    tone: Tone = "unknown" if "unknown" in tones else "bad" if "bad" in tones else "good"
    good = sum(outcome.tone == "good" for _, _, outcome in proofs)
    some = Message.of("result_of_some", n=len(proofs), good=good)
    in_all = OutcomeText(
        tone, joined((some, *failed_units((name, words) for name, _, words in proofs))) or some
    )
    left_out = _by_unit(form, "kept-")
    kept = left_out | {
        each.row.unit: each.row.typed
        for each, (_, _, outcome) in zip(results, proofs, strict=True)
        if outcome.tone != "good"
    }
    return page.render(
        "sets/_batch_done.html",
        fields=page.fields(),
        bus=page.name,
        parameter=parameter,
        proofs=[*proofs, *((page.name_of(unit), "", page.outcome_left_out(unit)) for unit in left_out)],
        undo=_undo(page, parameter, results),
        outcome=proofs[0][2] if len(proofs) == 1 else in_all,
        skew=None,
        rows=rows_of_batch(page.bus, number, kept),
    )


def _undo(page: BusPage, parameter: Parameter, results: list[BatchResult]) -> BatchUndo | None:
    offers = [offer for each in results if (offer := page.undo(each.id)) is not None]
    if not offers:
        return None
    values = {"number": str(parameter.number)} | {
        f"unit-{action.unit}": str(parameter_message(parameter, action.raw, page.bus.units[action.unit]))
        for offer in offers
        if isinstance(action := offer.action, WriteParameter)
    }
    text = offers[0].text if len(offers) == 1 else Message("undo_parameters")
    return BatchUndo(f"/batch/{page.name}/review", values, text, min(offer.until for offer in offers))


def _outcome(page: BusPage, written: BatchResult, parameter: Parameter) -> OutcomeText:
    part = written.part
    if not isinstance(part, Result):
        return OutcomeText("bad", part if isinstance(part, Message) else part.message)
    return parameter_outcome(page.bus.units[written.row.unit], parameter, page.in_words(part))


async def typed_batch(request: Request) -> tuple[int, dict[int, str]]:
    """Return the number of the parameter and the typed text for each unit."""
    form = await request.form()
    return parse_integer(str(form.get("number", ""))) or 0, _by_unit(form, "unit-")


def _by_unit(form: FormData, prefix: str) -> dict[int, str]:
    """Return the fields whose names are ``prefix`` and an address, by unit."""
    return {
        unit: str(value)
        for key, value in form.items()
        if key.startswith(prefix) and (unit := parse_integer(key.removeprefix(prefix))) is not None
    }


def writable_or_404(number: int) -> Parameter:
    """Return a parameter that can be written over the bus. Raise Problem 404."""
    parameter = PARAMETERS.get(number)
    if parameter is None or parameter.never_writable:
        raise Problem(404, "unknown_parameter", Message.of("parameter_not_writable", number=number))
    return parameter
