"""Reserves the wire for a sender that is about to write, while its request is still being read.

On a busy bus a poll is always in progress, and the next leaves within a millisecond of its end. A write
that arrives after that, because of its way through the app and onto its disk, would wait for one more
poll.
"""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Depends
from starlette.requests import HTTPConnection

from app.core.web.access import Person, Requires
from app.core.web.services import bus_service, bus_service_of
from app.line.commands.catalogue import WRITE_PARAMETER, CommandKind
from app.line.commands.service.command_service import CommandService

Commands = Annotated[CommandService, bus_service(CommandService)]
"""Sends commands to ``{bus}`` in the path."""


class _Writes(Requires):
    """A dependency that leaves the next turn of ``{bus}`` in the path free for whom it lets in.

    Whether the command comes late is judged where it is sent: its time may be another than that of any write,
    and one that was carried out before gives its result however late it is repeated.
    """

    async def grant(self, connection: HTTPConnection) -> Person:
        person = self.permitted(connection)
        if "bus" in connection.path_params:
            await bus_service_of(connection, connection.path_params["bus"], CommandService).reserve()
        return person


def permitted(kind: CommandKind[Any]) -> Any:
    """A dependency that lets in who may send such a command."""
    return Depends(Requires(kind.role, kind.request.__name__))


ParameterWriter = Annotated[Person, permitted(WRITE_PARAMETER)]
"""Who may write parameters: of one unit, of many, by a restore or in a unit swap."""


def permitted_writer(kind: CommandKind[Any]) -> Any:
    """A dependency that lets in who may send such a command, and leaves the next turn of the wire free."""
    return Depends(_Writes(kind.role, kind.request.__name__))
