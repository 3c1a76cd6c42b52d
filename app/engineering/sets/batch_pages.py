"""The page of a batch edit: choose a parameter, type, review, write, read the result of each unit."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response
from starlette.datastructures import FormData

from app.core.web.api.shape import parse_integer
from app.core.web.rendering.templating import render
from app.engineering.sets.batch import learn, refuse_moved, rows_of_batch, write_batch
from app.engineering.sets.restore.effects import OPERATING_VALUES, effect_message
from app.errors import Problem
from app.line.commands.service.writer import Commands, ParameterWriter
from app.line.live.api.routes import Live
from app.line.live.lookup import bus_or_404
from bus.catalogue.parameter import Parameter
from bus.catalogue.parameters import PARAMETERS
from bus.messages import Message

router = APIRouter(include_in_schema=False)


@router.get("/batch/{bus}")
async def batch_page(
    request: Request, person: ParameterWriter, live: Live, commands: Commands, bus: str, number: int = 6
) -> Response:
    """The present values of one parameter over all units; those never read are requested now."""
    parameter = writable_or_404(number)
    await learn(commands, person, bus_or_404(live, bus), number)
    rows = rows_of_batch(live.buses[bus], number, {})
    writable = [each for each in PARAMETERS.values() if not each.never_writable]
    return render(
        request, "sets/batch.html", bus=bus, parameter=parameter, rows=rows, parameters=writable, results=[]
    )


@router.post("/batch/{bus}/review")
async def batch_review(request: Request, _: ParameterWriter, live: Live, bus: str) -> Response:
    """What would be written, row by row; nothing is."""
    number, typed = await typed_batch(request)
    parameter = writable_or_404(number)
    rows = rows_of_batch(bus_or_404(live, bus), number, typed)
    danger = effect_message("setpoint") if number in OPERATING_VALUES else parameter.dangerous
    return render(request, "sets/_batch_review.html", bus=bus, parameter=parameter, rows=rows, danger=danger)


@router.post("/batch/{bus}/write")
async def batch_write(
    request: Request, person: ParameterWriter, live: Live, commands: Commands, bus: str
) -> Response:
    """Write what the review showed."""
    number, typed = await typed_batch(request)
    parameter = writable_or_404(number)
    rows = rows_of_batch(bus_or_404(live, bus), number, typed)
    if any(row.fault for row in rows):
        raise Problem(422, "invalid", Message("value_not_writable"))
    refuse_moved(rows, _by_unit(await request.form(), "was-"))
    results = await write_batch(commands, person, number, rows, confirm=bool(parameter.dangerous))
    undone = {result.unit for result in results if result.outcome != "verified"}
    rows = rows_of_batch(live.buses[bus], number, {unit: typed[unit] for unit in undone})
    return render(request, "sets/_batch_done.html", parameter=parameter, results=results, rows=rows)


async def typed_batch(request: Request) -> tuple[int, dict[int, str]]:
    """The number of the parameter, and what was typed for each unit."""
    form = await request.form()
    return parse_integer(str(form.get("number", ""))) or 0, _by_unit(form, "unit-")


def _by_unit(form: FormData, prefix: str) -> dict[int, str]:
    """The fields whose names are ``prefix`` and an address."""
    return {
        unit: str(value)
        for key, value in form.items()
        if key.startswith(prefix) and (unit := parse_integer(key.removeprefix(prefix))) is not None
    }


def writable_or_404(number: int) -> Parameter:
    """A parameter that can be written over the link. Raises Problem 404."""
    parameter = PARAMETERS.get(number)
    if parameter is None or parameter.never_writable:
        raise Problem(404, "unknown_parameter", Message.of("parameter_not_writable", number=number))
    return parameter
