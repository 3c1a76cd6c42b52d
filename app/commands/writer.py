"""Who is about to write: the wire is told while the request is still being read.

On a busy bus a poll is always under way, and what follows it leaves within a millisecond of its end. A write
that came too late for that by the time of its way through the app and onto its disk would wait for a whole
poll more.
"""

from __future__ import annotations

from typing import Annotated, cast

from fastapi import Depends
from starlette.requests import HTTPConnection

from app.commands.desk import Desk
from app.web.access import Engineer, Operator, Person


def desk_of(connection: HTTPConnection) -> Desk:
    """The way to the wire."""
    return cast(Desk, connection.app.state.services.desk)


async def _writer(person: Operator, connection: HTTPConnection, bus: str) -> Person:
    await desk_of(connection).reserve(bus)
    return person


async def _engineering_writer(person: Engineer, connection: HTTPConnection, bus: str) -> Person:
    await desk_of(connection).reserve(bus)
    return person


Writer = Annotated[Person, Depends(_writer)]
"""An operator, for whose write the next turn of ``{bus}`` is left free."""
EngineeringWriter = Annotated[Person, Depends(_engineering_writer)]
"""An engineer, likewise."""
