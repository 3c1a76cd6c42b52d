"""Undo: an ordinary command with an ordinary review, back to what was there before a command."""

from __future__ import annotations

from fastapi import APIRouter
from starlette.responses import Response

from app.core.web.access import Viewer
from app.errors import Problem
from app.line.commands.forms.page_context import BusPage, OfBus, UnitPage
from app.line.commands.forms.undo_shown import undo_shown
from app.line.commands.pages.outputs import review_analog_value, review_switch
from app.line.commands.pages.parameters import review_value
from app.line.commands.pages.setpoints import review_change
from app.line.commands.pages.speed import review_setpoint
from app.line.commands.service.undoing import UndoOffer
from bus.contract import SetLine, SetSpeed, WriteAnalogOutput, WriteOutput, WriteParameter
from bus.messages import Message, term

router = APIRouter(prefix="/bus/{bus}/undo", include_in_schema=False)


@router.get("")
async def newest(person: Viewer, page: OfBus, unit: int | None = None) -> Response:
    """The undo of the newest command to ``unit`` or, without one, to the bus; empty where there is none."""
    units = page.bus.units.keys() if unit is None else {unit}
    offer = page.commands.undo.newest(person, units)
    return page.render("components/_undo.html", undo=undo_shown(offer, page.bus, names_unit=unit is None))


@router.get("/{id}")
async def review_undo(person: Viewer, page: OfBus, id: str) -> Response:
    """The review of the undo of one command."""
    offer = page.commands.undo.offer(person, id)
    try:
        if offer is None:
            raise Problem(409, "moved", Message("undo_over"))
        return await _review(page, offer)
    except Problem as problem:
        return page.refused(problem, page.translator.t(term("Undo")))


async def _review(page: BusPage, offer: UndoOffer) -> Response:
    action = offer.action
    if isinstance(action, SetLine):
        page.undoes = offer.id
        return await review_change(page, action.setpoints)
    unit = UnitPage(page.request, page.name, action.units[0])
    unit.undoes = offer.id
    match action:
        case SetSpeed(raw=raw):
            return await review_setpoint(unit, raw)
        case WriteOutput(number=number, on=on):
            return review_switch(unit, number, on=on)
        case WriteAnalogOutput(raw=raw):
            return review_analog_value(unit, raw)
        case WriteParameter(number=number, raw=raw):
            return await review_value(unit, number, raw)
    raise TypeError(type(action))
