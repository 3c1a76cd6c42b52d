"""Batch edits: one parameter of many units, reviewed as a table, written unit by unit; and the page."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace

from fastapi import APIRouter, Request, Response
from starlette.datastructures import FormData

from app.core.web.access import Person
from app.core.web.arrival import Deadline
from app.core.web.routes import GuardedRoute
from app.core.web.shape import parse_integer
from app.engineering.sets.model import UnitRows, known_rows, status_of, with_unit
from app.errors import Problem
from app.line.commands.effects import OPERATING_VALUES, effect_message, warning_of
from app.line.commands.page_context import PageOfBus
from app.line.commands.review import by_remark
from app.line.commands.service import CommandService, ParameterWriter
from app.line.commands.values import parameter_scale
from app.line.live.bus_live import BusLive, UnitLive, is_driven
from bus.catalogue.parameters import (
    DECIMALS,
    FOLLOWER_MODE,
    PARAMETERS,
    Parameter,
    Scale,
    check_writable_value,
)
from bus.catalogue.values import StatusBits, is_follower, parameter_raw
from bus.contract import ReadParameters, UnitScale, WriteParameter
from bus.errors import CallerError
from bus.messages import Message

_OF_THE_PERSON = frozenset({"forbidden", "rights_withdrawn", "controlled"})
"""The refusals that would also meet every other unit."""
_LEARN_WITHIN_S = 10.0
"""The seconds to read one parameter of 255 units: 5 s at 9600 baud, twice that beside the scan."""


@dataclass(frozen=True, slots=True)
class BatchRow:
    """A unit of a batch, with the text that was ``typed`` for it.

    ``wanted``: the raw value to write, if any; ``fault``: the reason why the text is refused; ``warning``:
    the effect of the write on the machine now.
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
    warning: Message | None = None

    @property
    def changes(self) -> bool:
        """Whether there is a value to write that the unit does not have."""
        return self.wanted is not None and self.wanted != self.present_raw


@dataclass(frozen=True, slots=True)
class BatchResult:
    """The result at one unit; ``outcome``: of the command, or the code of its refusal."""

    unit: int
    name: str
    outcome: str
    message: Message | None


def rows_of_batch(bus: BusLive, number: int, typed: Mapping[int, str]) -> list[BatchRow]:
    """Return one row for each unit of the bus, with its present value and its typed text."""
    return [
        _row(unit, PARAMETERS[number], typed.get(key, "").strip(), status_of(bus, unit))
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
    commands: CommandService, person: Person, number: int, rows: list[BatchRow], *, confirm: bool
) -> list[BatchResult]:
    """Write the rows that change a value, one after another. A refusal that concerns the person ends the
    batch; a refusal that concerns one unit does not."""
    results: list[BatchResult] = []
    stopped_by: Message | None = None
    for row in rows:
        if row.changes and stopped_by:
            results.append(BatchResult(row.unit, row.name, "not_sent", stopped_by))
        elif row.changes:
            result = await _write(commands, person, number, row, confirm=confirm)
            results.append(result)
            stopped_by = result.message if result.outcome in _OF_THE_PERSON else None
    return results


def _row(unit: UnitLive, parameter: Parameter, typed: str, status: StatusBits | None) -> BatchRow:
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
        check_writable_value(parameter, wanted)
    except CallerError as error:
        return replace(row, fault=error.message)
    shown = _shown(parameter, wanted, known)
    warning = warning_of(parameter.number, wanted, running=None if status is None else is_driven(status))
    scale = parameter_scale(unit, parameter.number, wanted)
    return replace(row, wanted=wanted, scale=scale, shown=shown, warning=warning)


def _shown(parameter: Parameter, raw: int, known: UnitRows) -> Message:
    return Message("value_hidden") if parameter.secret else with_unit(parameter, raw, known)


async def _write(
    commands: CommandService, person: Person, number: int, row: BatchRow, *, confirm: bool
) -> BatchResult:
    action = WriteParameter(unit=row.unit, number=number, raw=row.wanted or 0)
    try:
        result = await commands.send(
            person, action, confirm=confirm, origin="batch edit", scales={row.unit: row.scale}
        )
    except Problem as problem:
        return BatchResult(row.unit, row.name, problem.code, problem.message)
    return BatchResult(row.unit, row.name, result.outcome, result.message)


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
    rows = rows_of_batch(page.bus, number, typed)
    unable = {row.unit: reason for row in rows if row.typed and (reason := page.obstacle(row.unit))}
    return page.render(
        "sets/_batch_review.html",
        bus=page.name,
        parameter=parameter,
        rows=[row for row in rows if row.typed and row.unit not in unable],
        left_out=by_remark((row.name, unable[row.unit]) for row in rows if row.unit in unable),
        danger=effect_message("setpoint") if number in OPERATING_VALUES else parameter.dangerous,
    )


@router.post("/batch/{bus}/write")
async def batch_write(request: Request, person: ParameterWriter, page: PageOfBus) -> Response:
    """Write the values that the review showed."""
    number, typed = await typed_batch(request)
    parameter = writable_or_404(number)
    rows = rows_of_batch(page.bus, number, typed)
    if any(row.fault for row in rows):
        raise Problem(422, "invalid", Message("value_not_writable"))
    refuse_moved(rows, _by_unit(await request.form(), "was-"))
    results = await write_batch(page.commands, person, number, rows, confirm=bool(parameter.dangerous))
    undone = {result.unit for result in results if result.outcome != "verified"}
    return page.render(
        "sets/_batch_done.html",
        fields=page.fields(),
        bus=page.name,
        parameter=parameter,
        results=results,
        rows=rows_of_batch(page.bus, number, {unit: typed[unit] for unit in undone}),
    )


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
