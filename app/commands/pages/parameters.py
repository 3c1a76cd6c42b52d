"""The parameters of a unit: the 40 by what they are for, each changed in place behind a review."""

from __future__ import annotations

from itertools import groupby
from typing import Annotated, Any

from fastapi import APIRouter, Form, Path
from starlette.responses import Response

from app.commands.api.bodies import Quantity
from app.commands.api.quantity import QuantityConverter
from app.commands.catalogue import READ_PARAMETERS, WRITE_PARAMETER
from app.commands.forms.outcome import OutcomeText
from app.commands.forms.page_context import Page, PageContext
from app.commands.forms.review import facts, judge
from app.commands.review.risks import obstacle_of, risks_of_writing
from app.commands.rules.setpoint_range import parameter_bounds
from app.commands.service.writer import permitted, permitted_writer
from app.commands.values import measure_of_value, parameter_message
from app.errors import Problem
from app.live.api.view import parameter_json
from app.live.state.bus_live import UnitLive
from app.web.access import Person, Viewer
from bus.catalogue.parameter import Parameter, danger_of_writing
from bus.catalogue.parameters import PARAMETERS
from bus.contract import ReadParameters, WriteParameter
from bus.errors import CallerError
from bus.instants import UnixTime
from bus.messages import Message

router = APIRouter(prefix="/units/{bus}/{unit:int}/parameters", include_in_schema=False)
ParameterPath = Annotated[int, Path(ge=1, le=40)]
CONFIRMING_WORD = "WRITE"


@router.get("")
async def parameters(_: Viewer, page: Page, bus: str, unit: int) -> Response:
    """All 40 as last read."""
    return page.render("unit/parameters.html", **_table(page, bus, unit))


@router.post("/read")
async def read_all(
    person: Annotated[Person, permitted(READ_PARAMETERS)], page: Page, bus: str, unit: int
) -> Response:
    """All 40 as the unit gives them now."""
    page.unit(bus, unit)
    action = ReadParameters(unit=unit, numbers=list(PARAMETERS))
    result = await page.commands(bus).send(person, action, origin="page")
    missing = len(PARAMETERS) - len(result.values)
    return page.render("unit/_parameters.html", missing=missing, **_table(page, bus, unit))


def _table(page: PageContext, bus: str, unit: int) -> dict[str, Any]:
    live = page.unit(bus, unit)
    rows = [_row(page, bus, live, number) for number in sorted(PARAMETERS, key=_by_group)]
    groups = [(name, list(members)) for name, members in groupby(rows, key=lambda row: row["group"])]
    return {"fields": page.fields(), "bus": bus, "unit": page.shown(bus, unit), "groups": groups}


_GROUPS = list(dict.fromkeys(parameter.group for parameter in PARAMETERS.values()))


def _by_group(number: int) -> tuple[int, int]:
    return _GROUPS.index(PARAMETERS[number].group), number


def _row(page: PageContext, bus: str, live: UnitLive, number: int) -> dict[str, Any]:
    known = live.parameters.get(number)
    lowest, highest = parameter_bounds(live, number, page.guards(bus).limits.of(live.settings.id))
    raw = None if known is None else known.raw
    shown = {
        "at": None if known is None else known.at,
        "value": None if raw is None else parameter_message(PARAMETERS[number], raw, live),
    }
    return parameter_json(live, number) | {"min": lowest, "max": highest} | shown


@router.post("/{number:int}/review")
async def review_parameter(
    person: Annotated[Person, permitted(WRITE_PARAMETER)],
    page: Page,
    bus: str,
    unit: int,
    number: ParameterPath,
    value: Annotated[str, Form(max_length=40)] = "",
) -> Response:
    """What was typed, judged and shown again: old → new, range, danger."""
    live, parameter = page.unit(bus, unit), PARAMETERS[number]
    try:
        typed = QuantityConverter(page.commands(bus), person, live, page.deadline(page.bus(bus)))
        raw = await typed.parameter(number, Quantity(value=value))
        await judge(page, person, bus, WriteParameter(unit=unit, number=number, raw=raw))
    except (CallerError, Problem) as error:
        return _not_so(page, live, parameter, error)
    lowest, highest = parameter_bounds(live, number, page.guards(bus).limits.of(unit))
    known = live.parameter_raw(number)
    return page.review(
        "unit/_review_parameter.html",
        lowest=lowest,
        highest=highest,
        unit=page.shown(bus, unit),
        parameter=parameter,
        raw=raw,
        old="" if known is None else parameter_message(parameter, known, live),
        new=parameter_message(parameter, raw, live),
        measure=measure_of_value(live, parameter, raw),
        obstacle=obstacle_of(facts(page, bus, unit)),
        risks=risks_of_writing(number, raw),
        danger=danger_of_writing(parameter, raw),
        typed=CONFIRMING_WORD,
    )


@router.post("/{number:int}")
async def write_parameter(
    person: Annotated[Person, permitted_writer(WRITE_PARAMETER)],
    page: Page,
    bus: str,
    unit: int,
    number: ParameterPath,
    raw: Annotated[int, Form(ge=0)],
    id: Annotated[str, Form(max_length=64)],
    reviewed_at: Annotated[UnixTime, Form()],
    typed: Annotated[str, Form(max_length=20)] = "",
) -> Response:
    """86h, read back by 85h; a dangerous one only with the word typed."""
    live, parameter = page.unit(bus, unit), PARAMETERS[number]
    title = f"#{number} {parameter.name}"
    try:
        page.refuse_lapsed(reviewed_at)
        if danger_of_writing(parameter, raw) and typed.strip() != CONFIRMING_WORD:
            raise Problem(409, "dangerous", Message("word_not_typed"))
        return await _write(person, page, bus, live, parameter, raw, id)
    except Problem as problem:
        return page.refused(problem, title)


async def _write(
    person: Person, page: PageContext, bus: str, live: UnitLive, parameter: Parameter, raw: int, id: str
) -> Response:
    unit, number = live.settings.id, parameter.number
    result = await page.send(person, bus, WriteParameter(unit=unit, number=number, raw=raw), id)
    outcome = page.outcome(result, live)
    if parameter.secret and result.outcome == "unverified":
        # Why, in words: the value that was read back is not here.
        outcome = OutcomeText(outcome.tone, page.translator.t(result.message or ""))
    elif result.read_back is not None:
        reads = page.translator.t(parameter_message(parameter, result.read_back, live))
        template = "verified: reads {value}" if result.outcome == "verified" else "reads {value} instead"
        outcome = OutcomeText(outcome.tone, page.translator.t(template, value=reads))
    return page.render(
        "unit/_parameter_done.html",
        title=f"#{number} {parameter.name}",
        outcome=outcome,
        bus=bus,
        unit=page.shown(bus, unit),
        row=_row(page, bus, live, number),
    )


def _not_so(
    page: PageContext, live: UnitLive, parameter: Parameter, error: CallerError | Problem
) -> Response:
    nearest = error.extra.get("nearest") if isinstance(error, Problem) else None
    value = None if nearest is None or parameter.secret else parameter_message(parameter, nearest, live)
    shown = "" if value is None else page.translator.t(value)
    reason = page.translator.t(error.message)
    if shown:
        # The rule speaks of raw values; what was typed here is what the unit shows.
        reason = page.translator.t(
            "out of range: the nearest allowed value is {value}; nothing was sent", value=shown
        )
    return page.not_so(reason, f"#parameter-{parameter.number}-error", nearest=shown)
