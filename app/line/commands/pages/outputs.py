"""The six outputs and the analog output of a unit, each behind a review."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Form, Path
from starlette.responses import Response

from app.errors import Problem
from app.line.commands.catalogue import WRITE_ANALOG_OUTPUT, WRITE_OUTPUT
from app.line.commands.forms.page_context import Confirmed, OfUnit, ReviewedScale, UnitPage
from app.line.commands.review import OutcomeText, outcome_text
from app.line.commands.service.writer import permitted, permitted_writer
from app.line.commands.values import analog_scale, scale_text
from bus.catalogue.numbers import ANALOG_OUT_HIGH, ANALOG_OUT_LOW
from bus.catalogue.status import output_is_on
from bus.catalogue.values import analog_output_volts
from bus.contract import WriteAnalogOutput, WriteOutput
from bus.errors import CallerError
from bus.messages import Message, term

router = APIRouter(prefix="/units/{bus}/{unit:int}", include_in_schema=False)
OutputPath = Annotated[int, Path(ge=1, le=6)]


@router.get("/outputs/{number:int}", dependencies=[permitted(WRITE_OUTPUT)])
async def review_output(page: OfUnit, number: OutputPath) -> Response:
    """The other state of an output, to be confirmed."""
    reading = page.unit.reading
    try:
        if reading is None:
            raise Problem(409, "unknown", Message("output_unknown"))
        return review_switch(page, number, on=not output_is_on(reading.outputs, number))
    except Problem as problem:
        return page.explain(problem, "#outputs-result", status=problem.status)


def review_switch(page: UnitPage, number: int, *, on: bool) -> Response:
    """A state of an output, to be confirmed. Raises Problem for what would not be sent."""
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
    page: OfUnit, number: OutputPath, on: Annotated[bool, Form()], confirmed: Confirmed
) -> Response:
    """87h, verified by the bit in ST2."""
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
async def review_analog(page: OfUnit, value: Annotated[str, Form(max_length=10)] = "") -> Response:
    """A value of the analog output, in volts too, to be confirmed."""
    try:
        return review_analog_value(page, typed_analog(value))
    except (CallerError, Problem) as error:
        return page.explain(error, "#analog-error")


def review_analog_value(page: UnitPage, raw: int) -> Response:
    """A value of the analog output, to be confirmed. Raises Problem for what would not be sent."""
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
    page: OfUnit, raw: Annotated[int, Form(ge=0)], confirmed: Confirmed, scale: ReviewedScale
) -> Response:
    """88h. The best outcome is acknowledged: there is nothing to read back."""
    try:
        result = await page.carry_out(WriteAnalogOutput(unit=page.id, raw=raw), confirmed, {page.id: scale})
    except Problem as problem:
        return page.not_sent(problem)
    return page.result(outcome_text(result), undo=page.undo(confirmed.id))


def typed_analog(text: str) -> int:
    """The value of an analog output that was typed. Raises CallerError."""
    if not text.strip().isdecimal() or len(text.strip()) > 6:
        raise CallerError(Message("whole_number_needed"))
    return int(text)


def _volts(page: UnitPage, raw: int) -> str:
    low, high = page.unit.parameter_raw(ANALOG_OUT_LOW), page.unit.parameter_raw(ANALOG_OUT_HIGH)
    if low is None or high is None or low == high:
        return ""
    return page.translator.formats.number(analog_output_volts(raw, low, high), 3)
