"""The six outputs and the analog output of a unit, each behind a review."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Form, Path
from starlette.responses import Response

from app.commands.catalogue import WRITE_ANALOG_OUTPUT, WRITE_OUTPUT
from app.commands.forms.outcome import OutcomeText
from app.commands.forms.page_context import Page, PageContext
from app.commands.forms.review import facts
from app.commands.review.risks import obstacle_of
from app.commands.service.writer import permitted, permitted_writer
from app.errors import Problem
from app.live.state.bus_live import UnitLive
from app.web.access import Person
from bus.catalogue.numbers import ANALOG_OUT_HIGH, ANALOG_OUT_LOW
from bus.catalogue.status import output_is_on
from bus.catalogue.values import analog_output_volts
from bus.contract import WriteAnalogOutput, WriteOutput
from bus.errors import CallerError
from bus.instants import UnixTime
from bus.messages import Message

router = APIRouter(prefix="/units/{bus}/{unit:int}", include_in_schema=False)
OutputPath = Annotated[int, Path(ge=1, le=6)]
ON, OFF = "on", "off"


def output_name(live: UnitLive, number: int) -> str:
    """The label of the output, or its number."""
    return live.settings.labels.output.get(number, "")


@router.get("/outputs/{number:int}")
async def review_output(
    person: Annotated[Person, permitted(WRITE_OUTPUT)], page: Page, bus: str, unit: int, number: OutputPath
) -> Response:
    """The other state of an output, to be confirmed."""
    live = page.unit(bus, unit)
    try:
        if live.reading is None:
            raise Problem(409, "unknown", Message("output_unknown"))
        on = not output_is_on(live.reading.outputs, number)
        page.commands(bus).check(person, WriteOutput(unit=unit, number=number, on=on), confirm=True)
    except Problem as problem:
        return page.refused(problem, live.settings.name)
    return page.review(
        "unit/_review_output.html",
        unit=page.shown(bus, unit),
        number=number,
        name=output_name(live, number),
        on=on,
        obstacle=obstacle_of(facts(page, bus, unit)),
    )


@router.post("/outputs/{number:int}")
async def set_output(
    person: Annotated[Person, permitted_writer(WRITE_OUTPUT)],
    page: Page,
    bus: str,
    unit: int,
    number: OutputPath,
    on: Annotated[bool, Form()],
    id: Annotated[str, Form(max_length=64)],
    reviewed_at: Annotated[UnixTime, Form()],
) -> Response:
    """87h, verified by the bit in ST2."""
    live = page.unit(bus, unit)
    try:
        page.refuse_lapsed(reviewed_at)
        result = await page.send(person, bus, WriteOutput(unit=unit, number=number, on=on), id)
    except Problem as problem:
        return page.refused(problem, live.settings.name)
    outcome = page.outcome(result)
    if result.outcome == "verified":
        state = page.translator.t(ON if on else OFF)
        outcome = OutcomeText(
            "good", page.translator.t("verified: output {n} is {state}", n=number, state=state)
        )
    return page.done(live.settings.name, outcome)


@router.post("/analog-output/review")
async def review_analog(
    person: Annotated[Person, permitted(WRITE_ANALOG_OUTPUT)],
    page: Page,
    bus: str,
    unit: int,
    value: Annotated[str, Form(max_length=10)] = "",
) -> Response:
    """A value of the analog output, in volts too, to be confirmed."""
    live = page.unit(bus, unit)
    try:
        raw = _integer(value)
        page.commands(bus).check(person, WriteAnalogOutput(unit=unit, raw=raw), confirm=True)
    except (CallerError, Problem) as error:
        return page.not_so(page.translator.t(error.message), "#analog-error")
    return page.review(
        "unit/_review_analog.html",
        unit=page.shown(bus, unit),
        raw=raw,
        volts=_volts(page, live, raw),
        obstacle=obstacle_of(facts(page, bus, unit)),
    )


@router.post("/analog-output")
async def set_analog(
    person: Annotated[Person, permitted_writer(WRITE_ANALOG_OUTPUT)],
    page: Page,
    bus: str,
    unit: int,
    raw: Annotated[int, Form(ge=0)],
    id: Annotated[str, Form(max_length=64)],
    reviewed_at: Annotated[UnixTime, Form()],
) -> Response:
    """88h. The best outcome is acknowledged: there is nothing to read back."""
    live = page.unit(bus, unit)
    try:
        page.refuse_lapsed(reviewed_at)
        result = await page.send(person, bus, WriteAnalogOutput(unit=unit, raw=raw), id)
    except Problem as problem:
        return page.refused(problem, live.settings.name)
    return page.done(live.settings.name, page.outcome(result))


def _integer(text: str) -> int:
    if not text.strip().isdecimal() or len(text.strip()) > 6:
        raise CallerError(Message("whole_number_needed"))
    return int(text)


def _volts(page: PageContext, live: UnitLive, raw: int) -> str:
    low, high = live.parameter_raw(ANALOG_OUT_LOW), live.parameter_raw(ANALOG_OUT_HIGH)
    if low is None or high is None or low == high:
        return ""
    return page.translator.formats.number(analog_output_volts(raw, low, high), 3)
