"""How a route reaches one of the app's services, by the name that it has among them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fastapi import Depends
from starlette.requests import HTTPConnection


def looked_up(find: Callable[[HTTPConnection], Any]) -> Any:
    """``Depends(find)`` for what is only looked up: FastAPI would send a plain function to a thread and wait
    for it there, and between an operator's press and the wire there is no time for that."""

    async def look_up(connection: HTTPConnection) -> Any:
        return find(connection)

    return Depends(look_up)


def service(name: str) -> Any:
    """A dependency of FastAPI: ``Keeper = Annotated[SetKeeper, service("sets")]``."""
    return looked_up(lambda connection: getattr(connection.app.state.services, name))
