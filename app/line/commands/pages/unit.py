"""The unit page and the faceplate beside the line: speed, limits, block, the six outputs and the analog
output; and the unit's 40 parameters in their groups, each changed in place behind a review."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from itertools import groupby
from typing import Annotated, Any

from fastapi import APIRouter, Form, Path
from starlette.responses import RedirectResponse, Response

from app.core.web.access import Person, Viewer
from app.core.web.routes import GuardedRoute
from app.core.web.services import service_of
from app.errors import Problem
from app.line.alarms.line_alarms import LineAlarms
from app.line.commands.catalogue import READ_PARAMETERS, WRITE_ANALOG_OUTPUT, WRITE_OUTPUT, WRITE_PARAMETER
from app.line.commands.effects import warning_of
from app.line.commands.limits import HIGHEST_SETPOINT, Limits
from app.line.commands.page_context import Confirmed, PageOfUnit, ReviewedScale, UnitPage
from app.line.commands.review import (
    OutcomeText,
    draw_seam,
    nudges,
    outcome_text,
    parameter_outcome,
    refused_parameter,
)
from app.line.commands.rules import parameter_bounds, setpoint_range
from app.line.commands.safeguards import BLOCK, SET_LIMITS, UNBLOCK
from app.line.commands.service import UnreadError, check_all_read, permitted, permitted_writer
from app.line.commands.values import (
    analog_scale,
    measure_of_setpoint,
    measure_of_value,
    parameter_message,
    parameter_scale,
    scale_text,
    setpoint_scale,
)
from app.line.conditions.condition import follower
from app.line.live.api.view import parameter_json
from app.line.live.bus_live import UnitLive, bits_of, is_driven, setpoint_decimals
from bus.catalogue.parameters import (
    ANALOG_OUT_HIGH,
    ANALOG_OUT_LOW,
    ANALOG_OUT_SOURCE,
    PARAMETERS,
    Parameter,
    danger_of_writing,
)
from bus.catalogue.values import analog_output_volts, output_is_on, speed_raw, speed_text
from bus.contract import ReadParameters, UnitScale, WriteAnalogOutput, WriteOutput, WriteParameter
from bus.errors import CallerError
from bus.instants import UnixTime
from bus.messages import NUMBER, Message, number, term
from bus.validation import OneLine

router = APIRouter(prefix="/units/{bus}/{unit:int}", include_in_schema=False, route_class=GuardedRoute)
TypedLimit = Annotated[str, Form(max_length=20)]
SEE_OTHER = 303


@router.get("")
async def unit_page(_: Viewer, page: PageOfUnit) -> Response:
    """Show one unit."""
    return page.render("unit/page.html", **_faceplate(page))


def _faceplate(page: UnitPage) -> dict[str, Any]:
    unit, limits = page.unit, page.guards.limits(page.id)
    return {
        **setting(page),
        "before": page.neighbor(-1),
        "after": page.neighbor(1),
        "limit_texts": {name: page.setpoint(getattr(limits, name)) for name in _LIMIT_NAMES},
        "analog_low": unit.parameter_raw(ANALOG_OUT_LOW),
        "analog_high": unit.parameter_raw(ANALOG_OUT_HIGH),
        "analog_by_link": unit.parameter_raw(ANALOG_OUT_SOURCE) == 2,
    }


_LIMIT_NAMES = ("lowest", "highest", "largest_step", "per_minute")


@router.post("/limits")
async def set_limits(
    person: Annotated[Person, SET_LIMITS.permitted],
    page: PageOfUnit,
    lowest: TypedLimit = "",
    highest: TypedLimit = "",
    largest_step: TypedLimit = "",
    per_minute: TypedLimit = "",
) -> Response:
    """Set all four limits at once; an empty field is no limit. Raise Problem 422 for a form without one."""
    await page.refuse_incomplete("lowest", "highest", "largest_step", "per_minute")
    try:
        typed = (_raw(page.unit, text) for text in (lowest, highest, largest_step, per_minute))
        limits = replace(Limits(*typed), decimals=setpoint_decimals(page.unit))
        if limits.lowest is not None and limits.highest is not None and limits.lowest > limits.highest:
            raise CallerError(Message("limits_reversed"))
    except (CallerError, Problem) as error:
        return page.explain(error.message, "#limits-result")
    await page.guards.set_limits(person, page.id, limits)
    return page.render("unit/_limits_set.html")


def _raw(live: UnitLive, text: str) -> int | None:
    """Parse a limit. Raise CallerError and Problem for any other text."""
    if not text.strip():
        return None
    decimals = setpoint_decimals(live)
    if decimals is None:
        raise CallerError(Message("decimals_unknown"))
    raw = speed_raw(text, decimals)
    if raw > HIGHEST_SETPOINT:
        raise Problem(
            422,
            "invalid",
            Message.of("protocol_maximum", most=number(speed_text(HIGHEST_SETPOINT, decimals))),
        )
    return raw


@router.post("/block")
async def block(
    person: Annotated[Person, BLOCK.permitted],
    page: PageOfUnit,
    reason: Annotated[OneLine, Form(max_length=200)] = "",
) -> Response:
    """Refuse every write to this unit, with the reason shown on every page."""
    if not reason.strip():
        raise Problem(422, "invalid", Message("block_needs_reason"))
    await page.guards.block(person, page.id, reason.strip())
    return RedirectResponse(page.on_line.href, SEE_OTHER)


@router.get("/unblock", dependencies=[UNBLOCK.permitted])
async def review_unblock(page: PageOfUnit) -> Response:
    """Review the end of a block: its reason, who set it, what becomes possible."""
    block = page.guards.block_of(page.id)
    if block is None:
        return Response(headers={"HX-Redirect": page.on_line.href})
    return page.review("unit/_review_unblock.html", unit=page.on_line, block=block, fields=page.fields())


@router.post("/unblock")
async def unblock(
    person: Annotated[Person, UNBLOCK.permitted],
    page: PageOfUnit,
    confirmed: Confirmed,
    set_at: Annotated[UnixTime, Form()],
) -> Response:
    """Lift the block that was reviewed, which was set at ``set_at``; the event records the user."""
    try:
        confirmed.refuse_lapsed()
        block = page.guards.block_of(page.id)
        if block is not None and block.set_at != set_at:
            raise Problem(409, "moved", Message("block_moved"))
    except Problem as problem:
        return page.refused(problem, page.title)
    await page.guards.lift(person, page.id)
    return Response(headers={"HX-Redirect": page.on_line.href})


@router.get("/faceplate")
async def faceplate(_: Viewer, page: PageOfUnit) -> Response:
    """Show state, cause, alarms with their responses, speed and its field, lamps."""
    alarms = service_of(page.request, LineAlarms).unit_alarms(page.name, page.id)
    return page.render("line/_faceplate.html", alarms=alarms, **setting(page))


def setting(page: UnitPage) -> dict[str, Any]:
    """Return the unit, and the context of the fields for its setpoint."""
    allowed = setpoint_range(page.unit, page.guards.limits(page.id))
    small = nudges(page.unit)
    after = page.neighbor(1)
    seams = [draw_seam(page.bus, unit) for unit in (page.id, after.id if after else page.id)]
    steps = [(1, step) for step in reversed(small)] + [(-1, step) for step in small]
    return {
        "fields": page.fields(),
        "bus": page.name,
        "unit": page.on_line,
        "present": page.setpoint(page.present),
        "lowest": page.setpoint(allowed.lowest),
        "highest": page.setpoint(allowed.highest),
        "bounds_unit": measure_of_setpoint(page.unit),
        "follower": bool(follower(page.unit)),
        "scale": scale_text(setpoint_scale(page.unit, 1)),
        "nudges": [(sign * step, page.setpoint(step), sign) for sign, step in steps],
        "block": page.guards.block_of(page.id),
        "lifted": page.guards.lifted(page.id),
        "draws": dict.fromkeys(seam for seam in seams if seam is not None),
    }


OutputPath = Annotated[int, Path(ge=1, le=6)]


@router.get("/outputs/{number:int}", dependencies=[permitted(WRITE_OUTPUT)])
async def review_output(page: PageOfUnit, number: OutputPath) -> Response:
    """Review the other state of an output."""
    reading = page.unit.reading
    try:
        if reading is None:
            raise Problem(409, "unknown", Message("output_unknown"))
        return review_switch(page, number, on=not output_is_on(reading.outputs, number))
    except Problem as problem:
        return page.explain(problem, "#outputs-result", status=problem.status)


def review_switch(page: UnitPage, number: int, *, on: bool) -> Response:
    """Review a state of an output. Raise Problem if it would not be sent."""
    page.check(WriteOutput(unit=page.id, number=number, on=on))
    return page.review(
        "unit/_review_output.html",
        unit=page.on_line,
        number=number,
        name=page.unit.settings.labels.output.get(number, ""),
        on=on,
        obstacle=page.obstacle(page.id),
    )


@router.post("/outputs/{number:int}", dependencies=[permitted_writer(WRITE_OUTPUT)])
async def set_output(
    page: PageOfUnit, number: OutputPath, on: Annotated[bool, Form()], confirmed: Confirmed
) -> Response:
    """Send 87h, verified by the bit in ST2."""
    try:
        result = await page.carry_out(WriteOutput(unit=page.id, number=number, on=on), confirmed)
    except Problem as problem:
        return page.not_sent(problem)
    outcome = outcome_text(result)
    if result.outcome == "verified":
        state = term("on") if on else term("off")
        outcome = OutcomeText("good", Message.of("result_output", n=number, state=state))
    return page.result(outcome, undo=page.undo(confirmed.id))


@router.post("/analog-output/review", dependencies=[permitted(WRITE_ANALOG_OUTPUT)])
async def review_analog(page: PageOfUnit, value: Annotated[str, Form(max_length=10)] = "") -> Response:
    """Review a typed value of the analog output."""
    try:
        return review_analog_value(page, typed_analog(value))
    except (CallerError, Problem) as error:
        return page.explain(error, "#analog-error")


def review_analog_value(page: UnitPage, raw: int) -> Response:
    """Review a value of the analog output, in volts too. Raise Problem if it would not be sent."""
    page.check(WriteAnalogOutput(unit=page.id, raw=raw))
    return page.review(
        "unit/_review_analog.html",
        unit=page.on_line,
        raw=raw,
        scale=scale_text(analog_scale(page.unit)),
        volts=_volts(page, raw),
        obstacle=page.obstacle(page.id),
    )


@router.post("/analog-output", dependencies=[permitted_writer(WRITE_ANALOG_OUTPUT)])
async def set_analog(
    page: PageOfUnit, raw: Annotated[int, Form(ge=0)], confirmed: Confirmed, scale: ReviewedScale
) -> Response:
    """Send 88h. The best outcome is acknowledged, because nothing can be read back."""
    try:
        result = await page.carry_out(WriteAnalogOutput(unit=page.id, raw=raw), confirmed, {page.id: scale})
    except Problem as problem:
        return page.not_sent(problem)
    return page.result(outcome_text(result), undo=page.undo(confirmed.id))


def typed_analog(text: str) -> int:
    """Parse a typed value of the analog output. Raise CallerError."""
    if not text.strip().isdecimal() or len(text.strip()) > 6:
        raise CallerError(Message("whole_number_needed"))
    return int(text)


def _volts(page: UnitPage, raw: int) -> str:
    low, high = page.unit.parameter_raw(ANALOG_OUT_LOW), page.unit.parameter_raw(ANALOG_OUT_HIGH)
    if low is None or high is None or low == high:
        return ""
    return page.translator.formats.number(analog_output_volts(raw, low, high), 3)


parameters_router = APIRouter(
    prefix="/units/{bus}/{unit:int}/parameters", include_in_schema=False, route_class=GuardedRoute
)
ParameterPath = Annotated[int, Path(ge=1, le=40)]
CONFIRMING_WORD = "WRITE"


@parameters_router.get("")
async def parameters(_: Viewer, page: PageOfUnit) -> Response:
    """Show all 40 parameters as last read."""
    return page.render("unit/parameters.html", **_table(page))


@parameters_router.post("/read", dependencies=[permitted(READ_PARAMETERS)])
async def read_all(page: PageOfUnit, reload: bool = False) -> Response:
    """Read all 40 parameters from the unit now. ``reload``: for a page that shows them in its own way."""
    action = ReadParameters(unit=page.id, numbers=list(PARAMETERS))
    result = await page.commands.send(page.person, action, origin="page")
    if reload:
        check_all_read(page.id, action.numbers, result)
        return Response(headers={"HX-Refresh": "true"})
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


def _range(page: UnitPage, number: int) -> dict[str, Any]:
    """Return the raw range of a parameter, and as ``typed`` that in which it is typed, if it is another."""
    lowest, highest = parameter_bounds(page.unit, number, page.guards.limits(page.id))
    typed = [parameter_message(PARAMETERS[number], raw, page.unit) for raw in (lowest, highest)]
    is_scaled = all(each.code == NUMBER for each in typed) and str(typed[1]) != str(highest)
    return {"min": lowest, "max": highest, "typed_range": typed if is_scaled else None}


def _row(page: UnitPage, number: int) -> dict[str, Any]:
    known = page.unit.parameters.get(number)
    raw = None if known is None else known.raw
    shown = {
        "at": None if known is None else known.at,
        "value": None if raw is None else parameter_message(PARAMETERS[number], raw, page.unit),
        "golden": page.golden_values().get(number),
    }
    return parameter_json(page.unit, number) | _range(page, number) | shown


@parameters_router.post("/{number:int}/review", dependencies=[permitted(WRITE_PARAMETER)])
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
    known = page.unit.parameter_raw(number)
    reading = page.unit.reading
    running = None if reading is None else is_driven(bits_of(page.bus, reading))
    warning = warning_of(number, raw, running=running)
    return page.review(
        "unit/_review_parameter.html",
        range=_range(page, number),
        row=_row(page, number),
        unit=page.on_line,
        parameter=parameter,
        raw=raw,
        scale=scale_text({**parameter_scale(page.unit, number, raw), **(typed_with or {})}),
        old="" if known is None else parameter_message(parameter, known, page.unit),
        was="" if known is None or parameter.secret else known,
        new=parameter_message(parameter, raw, page.unit),
        measure=measure_of_value(page.unit, parameter, raw),
        obstacle=page.obstacle(page.id),
        risks=[] if warning is None else [warning],
        danger=danger_of_writing(parameter, raw),
        typed=CONFIRMING_WORD,
    )


@parameters_router.post("/{number:int}", dependencies=[permitted_writer(WRITE_PARAMETER)])
async def write_parameter(
    page: PageOfUnit,
    number: ParameterPath,
    raw: Annotated[int, Form(ge=0)],
    confirmed: Confirmed,
    scale: ReviewedScale,
    typed: Annotated[str, Form(max_length=20)] = "",
    was: Annotated[str, Form(max_length=10)] = "",
) -> Response:
    """Send 86h, read back by 85h; a dangerous value only if the word was typed. ``was``: the raw value that
    the review showed. An undo is checked more strictly when it is sent."""
    parameter = PARAMETERS[number]
    try:
        is_new = not await page.has_sent(confirmed.id)
        if is_new:
            # The keypad may have changed the value during the review: event and undo say what was there.
            await page.commands.read(page.person, page.id, [number], page.deadline())
        known = page.unit.parameter_raw(number)
        # A form that comes twice at once may find its own value, and gets the result of the first.
        if is_new and known not in (None, raw) and was not in ("", str(known)) and not confirmed.undoes:
            shown = parameter_message(parameter, known, page.unit)
            outcome = OutcomeText("bad", Message.of("parameter_moved", value=shown))
            return _written(page, number, raw, outcome, status=409)
        if danger_of_writing(parameter, raw) and typed.strip() != CONFIRMING_WORD:
            raise Problem(409, "dangerous", Message("word_not_typed"))
        action = WriteParameter(unit=page.id, number=number, raw=raw)
        result = await page.carry_out(action, confirmed, {page.id: scale})
    except UnreadError as error:
        result = page.in_words(error.result(confirmed.id, [page.id]))
    except Problem as problem:
        return page.not_sent(problem)
    outcome = parameter_outcome(page.unit, parameter, result)
    return _written(page, number, raw, outcome, undo=page.undo(confirmed.id))


def _written(page: UnitPage, number: int, raw: int, outcome: OutcomeText, **more: Any) -> Response:
    return page.render(
        "unit/_parameter_done.html",
        outcome=outcome,
        requested=parameter_message(PARAMETERS[number], raw, page.unit),
        unit=page.on_line,
        row=_row(page, number),
        **{"undo": None, **more},
    )


def _explain(page: UnitPage, parameter: Parameter, error: CallerError | Problem) -> Response:
    place = f"#parameter-{parameter.number}-error"
    if isinstance(error, Problem) and "nearest" not in error.extra:
        return page.explain(error, place)
    reason, nearest = refused_parameter(page.unit, parameter, error, page.guards.limits(page.id))
    return page.explain(reason, place, nearest=nearest)
