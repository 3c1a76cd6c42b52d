"""Adding to the change tray: beside each way to set a value, with the same checks and the same refusals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from fastapi import APIRouter, Form
from starlette.requests import Request
from starlette.responses import Response

from app.core.web.admission.arrival import Deadline
from app.engineering.recipes.api import KnownRecipe
from app.engineering.recipes.rules import why_not_setpoint
from app.engineering.sets.batch import rows_of_batch
from app.engineering.sets.batch_pages import typed_batch, writable_or_404
from app.engineering.sets.lookup import KnownRestore, Restores
from app.engineering.sets.restore.pages import Ticks, ticked
from app.engineering.tray.own_tray import OwnTray
from app.errors import Problem
from app.line.commands.catalogue import SET_LINE, SET_SPEED, WRITE_ANALOG_OUTPUT, WRITE_OUTPUT
from app.line.commands.forms.page_context import BusPage, OfBus, OfUnit, Page, ReviewedScale
from app.line.commands.pages.outputs import OutputPath, typed_analog
from app.line.commands.pages.parameters import ParameterPath
from app.line.commands.pages.setpoints import typed_setpoints
from app.line.commands.pages.speed import explain_setpoint
from app.line.commands.service.writer import ParameterWriter, permitted
from app.line.commands.undo.changes import ValuePlace, Values
from app.line.commands.values import Scales, parse_scale
from bus.errors import CallerError
from bus.messages import Message

router = APIRouter(include_in_schema=False)
TypedText = Annotated[str, Form(max_length=40)]


async def _added(
    page: BusPage, changes: Values, deadline: Deadline | None = None, scales: Scales | None = None
) -> Response:
    await OwnTray(page).add(changes, deadline, scales)
    return page.render("tray/_added.html", added=len(changes))


def _setpoints(raw: Mapping[int, int]) -> Values:
    return {ValuePlace("setpoint", unit): value for unit, value in raw.items()}


@router.post("/units/{bus}/{unit:int}/tray/setpoint", dependencies=[permitted(SET_SPEED)])
async def add_setpoint(page: OfUnit, value: TypedText = "") -> Response:
    """A setpoint, as typed."""
    try:
        return await _added(page, _setpoints({page.id: await page.typed(page.id).setpoint(value)}))
    except (CallerError, Problem) as error:
        return explain_setpoint(page, error)


@router.post("/units/{bus}/{unit:int}/tray/outputs/{number:int}", dependencies=[permitted(WRITE_OUTPUT)])
async def add_output(page: OfUnit, number: OutputPath, on: Annotated[bool, Form()]) -> Response:
    """A state of an output."""
    try:
        return await _added(page, {ValuePlace("output", page.id, number): int(on)})
    except Problem as problem:
        return page.explain(problem, "#outputs-result", status=problem.status)


@router.post("/units/{bus}/{unit:int}/tray/analog-output", dependencies=[permitted(WRITE_ANALOG_OUTPUT)])
async def add_analog(page: OfUnit, value: TypedText = "") -> Response:
    """A value of the analog output, as typed."""
    try:
        return await _added(page, {ValuePlace("analog", page.id): typed_analog(value)})
    except (CallerError, Problem) as error:
        return page.explain(error, "#analog-error")


@router.post("/units/{bus}/{unit:int}/tray/parameters/{number:int}")
async def add_parameter(
    _: ParameterWriter,
    page: OfUnit,
    number: ParameterPath,
    raw: Annotated[int, Form(ge=0)],
    scale: ReviewedScale,
) -> Response:
    """A value of a parameter, from its review."""
    try:
        return await _added(page, {ValuePlace("parameter", page.id, number): raw}, scales={page.id: scale})
    except Problem as problem:
        return page.explain(problem, f"#parameter-{number}-error")


@router.post("/bus/{bus}/tray/setpoints", dependencies=[permitted(SET_LINE)])
async def add_setpoints(request: Request, page: OfBus) -> Response:
    """Every setpoint that was typed."""
    try:
        setpoints, scales = await typed_setpoints(page, await request.form())
        return await _added(page, _setpoints(setpoints), page.deadline(len(setpoints)), scales)
    except (CallerError, Problem) as error:
        return page.explain(error, f"#setpoints-error-{page.name}")


@router.post("/recipes/{recipe_id}/tray", dependencies=[permitted(SET_LINE)])
async def add_recipe(page: Page, recipe: KnownRecipe) -> Response:
    """Every setpoint of a recipe."""
    of_bus = page.of_bus(recipe.bus)
    try:
        for setpoint in recipe.setpoints:
            if reason := why_not_setpoint(setpoint, of_bus.bus):
                name = Message.of("unit_address", unit=setpoint.unit)
                raise Problem(409, "not_loadable", Message.of("of_unit", name=name, reason=reason))
        setpoints = {setpoint.unit: setpoint.raw for setpoint in recipe.setpoints}
        scales = {each.unit: parse_scale(each.scale) for each in recipe.setpoints if each.scale}
        return await _added(of_bus, _setpoints(setpoints), of_bus.deadline(len(setpoints)), scales)
    except Problem as problem:
        return page.explain(problem, "#recipe-error")


@router.post("/batch/{bus}/tray")
async def add_batch(request: Request, _: ParameterWriter, page: OfBus) -> Response:
    """Every value of a batch edit that differs from that of its unit."""
    number, typed = await typed_batch(request)
    writable_or_404(number)
    rows = rows_of_batch(page.bus, number, typed)
    try:
        for row in rows:
            if row.fault is not None:
                raise Problem(422, "invalid", Message.of("of_unit", name=row.name, reason=row.fault))
        changes = {
            ValuePlace("parameter", row.unit, number): row.wanted
            for row in rows
            if row.changes and row.wanted is not None
        }
        if not changes:
            raise CallerError(Message("tray_nothing_to_add"))
        return await _added(page, changes, scales={row.unit: row.scale for row in rows})
    except (CallerError, Problem) as error:
        return page.explain(error, "#batch-error")


@router.post("/restores/{restore_id}/tray")
async def add_restore(
    person: ParameterWriter, page: Page, restores: Restores, restore: KnownRestore, row: Ticks = None
) -> Response:
    """The rows of a restore that are ticked, in the order of its plan."""
    of_bus = page.of_bus(restore.bus)
    try:
        restores.select(person, restore, ticked(restore, frozenset(row or ())))
        changes = {
            ValuePlace("parameter", restore.unit, write.number): write.wanted for write in restore.plan.writes
        }
        # Of a stored set: its values are raw, and an earlier row may be the scale of a later one.
        return await _added(of_bus, changes, scales={restore.unit: {}})
    except Problem as problem:
        return page.explain(problem, "#restore-error")
