"""The parameters of a unit: the 40 in their groups, each changed in place behind a review."""

from __future__ import annotations

from contextlib import suppress
from itertools import groupby
from typing import Annotated, Any

from fastapi import APIRouter, Form, Path
from starlette.responses import Response

from app.core.web.access import Viewer
from app.core.web.routes import GuardedRoute
from app.errors import Problem
from app.line.commands.catalogue import READ_PARAMETERS, WRITE_PARAMETER
from app.line.commands.page_context import Confirmed, PageOfUnit, ReviewedScale, UnitPage
from app.line.commands.review import OutcomeText, outcome_text, risks_of_writing
from app.line.commands.rules import parameter_bounds
from app.line.commands.service import permitted, permitted_writer
from app.line.commands.values import measure_of_value, parameter_message, parameter_scale, scale_text
from app.line.live.api.view import parameter_json
from bus.catalogue.parameters import PARAMETERS, Parameter, danger_of_writing
from bus.contract import ReadParameters, Result, UnitScale, WriteParameter
from bus.errors import CallerError
from bus.messages import Message

router = APIRouter(
    prefix="/units/{bus}/{unit:int}/parameters", include_in_schema=False, route_class=GuardedRoute
)
ParameterPath = Annotated[int, Path(ge=1, le=40)]
CONFIRMING_WORD = "WRITE"


@router.get("")
async def parameters(_: Viewer, page: PageOfUnit) -> Response:
    """Show all 40 parameters as last read."""
    return page.render("unit/parameters.html", **_table(page))


@router.post("/read", dependencies=[permitted(READ_PARAMETERS)])
async def read_all(page: PageOfUnit) -> Response:
    """Read all 40 parameters from the unit now."""
    action = ReadParameters(unit=page.id, numbers=list(PARAMETERS))
    result = await page.commands.send(page.person, action, origin="page")
    missing = len(PARAMETERS) - len(result.values)
    return page.render("unit/_parameters.html", missing=missing, **_table(page))


def _table(page: UnitPage) -> dict[str, Any]:
    rows = [_row(page, number) for number in sorted(PARAMETERS, key=_by_group)]
    groups = [(name, list(members)) for name, members in groupby(rows, key=lambda row: row["group"])]
    shown = {"unit": page.on_line, "before": page.neighbor(-1), "after": page.neighbor(1)}
    return {"fields": page.fields(), "bus": page.name, "groups": groups, **shown}


_GROUPS = list(dict.fromkeys(parameter.group for parameter in PARAMETERS.values()))


def _by_group(number: int) -> tuple[int, int]:
    return _GROUPS.index(PARAMETERS[number].group), number


def _row(page: UnitPage, number: int) -> dict[str, Any]:
    known = page.unit.parameters.get(number)
    lowest, highest = parameter_bounds(page.unit, number, page.guards.limits(page.id))
    raw = None if known is None else known.raw
    shown = {
        "at": None if known is None else known.at,
        "value": None if raw is None else parameter_message(PARAMETERS[number], raw, page.unit),
        "golden": page.golden_values().get(number),
    }
    return parameter_json(page.unit, number) | {"min": lowest, "max": highest} | shown


@router.post("/{number:int}/review", dependencies=[permitted(WRITE_PARAMETER)])
async def review_parameter(
    page: PageOfUnit, number: ParameterPath, value: Annotated[str, Form(max_length=40)] = ""
) -> Response:
    """Review a typed value: old → new, range, danger."""
    try:
        raw, typed_with = await page.commands.convert_parameter(
            page.person, page.id, number, value, page.deadline()
        )
        return await review_value(page, number, raw, typed_with)
    except (CallerError, Problem) as error:
        return _explain(page, PARAMETERS[number], error)


async def review_value(
    page: UnitPage, number: int, raw: int, typed_with: UnitScale | None = None
) -> Response:
    """Review a value of a parameter; ``typed_with``: its scale, if it was typed. Raise Problem if it would
    not be sent."""
    parameter = PARAMETERS[number]
    await page.judge(WriteParameter(unit=page.id, number=number, raw=raw))
    # The keypad may have changed the value since it was read: old and new are shown, and undo restores it.
    with suppress(Problem):
        await page.commands.read(page.person, page.id, [number], page.deadline())
    lowest, highest = parameter_bounds(page.unit, number, page.guards.limits(page.id))
    known = page.unit.parameter_raw(number)
    return page.review(
        "unit/_review_parameter.html",
        lowest=lowest,
        highest=highest,
        unit=page.on_line,
        parameter=parameter,
        raw=raw,
        scale=scale_text({**parameter_scale(page.unit, number, raw), **(typed_with or {})}),
        old="" if known is None else parameter_message(parameter, known, page.unit),
        new=parameter_message(parameter, raw, page.unit),
        measure=measure_of_value(page.unit, parameter, raw),
        obstacle=page.obstacle(page.id),
        risks=risks_of_writing(number, raw),
        danger=danger_of_writing(parameter, raw),
        typed=CONFIRMING_WORD,
    )


@router.post("/{number:int}", dependencies=[permitted_writer(WRITE_PARAMETER)])
async def write_parameter(
    page: PageOfUnit,
    number: ParameterPath,
    raw: Annotated[int, Form(ge=0)],
    confirmed: Confirmed,
    scale: ReviewedScale,
    typed: Annotated[str, Form(max_length=20)] = "",
) -> Response:
    """Send 86h, read back by 85h; a dangerous value only if the word was typed."""
    parameter = PARAMETERS[number]
    try:
        if danger_of_writing(parameter, raw) and typed.strip() != CONFIRMING_WORD:
            raise Problem(409, "dangerous", Message("word_not_typed"))
        action = WriteParameter(unit=page.id, number=number, raw=raw)
        result = await page.carry_out(action, confirmed, {page.id: scale})
    except Problem as problem:
        return page.not_sent(problem)
    return page.render(
        "unit/_parameter_done.html",
        outcome=_outcome(page, parameter, result),
        unit=page.on_line,
        row=_row(page, number),
        undo=page.undo(confirmed.id),
    )


def _outcome(page: UnitPage, parameter: Parameter, result: Result) -> OutcomeText:
    if parameter.secret and result.outcome == "unverified" and result.message:
        # This gives the reason in words: the value that was read back is not here.
        return OutcomeText("unknown", result.message)
    return outcome_text(result, lambda raw: parameter_message(parameter, raw, page.unit))


def _explain(page: UnitPage, parameter: Parameter, error: CallerError | Problem) -> Response:
    nearest = error.extra.get("nearest") if isinstance(error, Problem) else None
    place = f"#parameter-{parameter.number}-error"
    if nearest is None or parameter.secret:
        return page.explain(error, place)
    # The rule names raw values; the value typed here is as the unit shows it.
    shown = parameter_message(parameter, nearest, page.unit)
    return page.explain(Message.of("parameter_out_of_range", value=shown), place, nearest=shown)
