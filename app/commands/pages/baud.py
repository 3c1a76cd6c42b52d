"""The baud rate of a line: reviewed, confirmed by typing, changed at every unit, verified, or reverted."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Form
from starlette.responses import Response

from app.commands.catalogue import CHANGE_BAUD
from app.commands.forms.page_context import Page
from app.commands.service.writer import permitted
from app.errors import Problem
from app.web.access import Person
from app.web.deadline import Deadline
from bus.contract import ChangeBaud
from bus.messages import Message
from bus.settings import BAUDS

router = APIRouter(prefix="/bus/{bus}/baud", include_in_schema=False)
CHANGE_S = 30.0
"""Every unit written, looked for at two rates, and written back if need be."""


@router.get("")
async def review(_: Annotated[Person, permitted(CHANGE_BAUD)], page: Page, bus: str, baud: int) -> Response:
    """The second step; nothing has been sent."""
    live = page.bus(bus)
    if baud not in BAUDS:
        raise Problem(422, "invalid", Message.of("baud_unknown", rates=", ".join(map(str, BAUDS))))
    if baud == live.baud:
        raise Problem(422, "invalid", Message.of("baud_unchanged", baud=baud))
    return page.review("bus/_review_baud.html", bus=live, baud=baud)


@router.post("")
async def change(
    person: Annotated[Person, permitted(CHANGE_BAUD)],
    page: Page,
    bus: str,
    baud: Annotated[int, Form()],
    id: Annotated[str, Form(min_length=8, max_length=200)],
) -> Response:
    """Change it at every unit; a result for each."""
    live = page.bus(bus)
    result = await page.send(person, bus, ChangeBaud(baud=baud), id, Deadline(page.made_at, CHANGE_S))
    return page.render(
        "bus/_baud_done.html", bus=live, baud=baud, outcome=page.outcome(result), result=result
    )
