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
from app.web.access import Person, Requires, Role


def desk_of(connection: HTTPConnection) -> Desk:
    """The way to the wire."""
    return cast(Desk, connection.app.state.services.desk)


class _Writes(Requires):
    """A dependency that leaves the next turn of ``{bus}`` in the path free for whom it lets in."""

    async def __call__(self, connection: HTTPConnection) -> Person:
        person = await super().__call__(connection)
        await desk_of(connection).reserve(connection.path_params["bus"])
        return person


Writer = Annotated[Person, Depends(_Writes(Role.OPERATOR))]
"""An operator, for whose write the next turn of ``{bus}`` is left free."""
EngineeringWriter = Annotated[Person, Depends(_Writes(Role.ENGINEER))]
"""An engineer, likewise."""
