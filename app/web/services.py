"""How a route reaches one of the app's services: by its type."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, TypeVar

from fastapi import Depends
from starlette.requests import HTTPConnection

S = TypeVar("S")


class Registry:
    """The services of an app, one of each type."""

    def __init__(self, services: Iterable[object]) -> None:
        self._services = {type(each): each for each in services}

    def __getitem__(self, kind: type[S]) -> S:
        found = self._services[kind]
        assert isinstance(found, kind)
        return found


def service_of(connection: HTTPConnection, kind: type[S]) -> S:
    """The service of this type."""
    registry: Registry = connection.app.state.registry
    return registry[kind]


def looked_up(find: Callable[[HTTPConnection], Any]) -> Any:
    """``Depends(find)`` for what is only looked up: FastAPI would send a plain function to a thread and wait
    for it there, and between an operator's press and the wire there is no time for that."""

    async def look_up(connection: HTTPConnection) -> Any:
        return find(connection)

    return Depends(look_up)


def service(kind: type[Any]) -> Any:
    """A dependency of FastAPI: ``Keeper = Annotated[SetKeeper, service(SetKeeper)]``."""
    return looked_up(partial(service_of, kind=kind))
