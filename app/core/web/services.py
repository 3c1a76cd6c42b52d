"""The lookup by which a route finds a service of the app: by its type. A bus that is not configured is
refused."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any, TypeVar

from fastapi import Depends
from starlette.requests import HTTPConnection

from app.errors import Problem
from bus.messages import Message


def unknown_bus(bus: str, known: Iterable[str]) -> Problem:
    """Return the 404 for a bus; ``known`` are the names of the configured ones."""
    return Problem(404, "unknown_bus", Message.of("no_such_bus", bus=bus, known=", ".join(known) or "none"))


def unknown_unit(bus: str, unit: int) -> Problem:
    """Return the 404 for a unit that its bus does not have."""
    return Problem(404, "unknown_unit", Message.of("no_such_unit", bus=bus, unit=unit), unit=unit)


S = TypeVar("S")


class Registry:
    """The services of an app, one of each type; ``buses``: those of each bus, by its name. Raises
    RuntimeError for two services of one type: a route could not choose between them."""

    def __init__(
        self, services: Iterable[object] = (), buses: Mapping[str, Iterable[object]] | None = None
    ) -> None:
        self._services: dict[type[object], object] = {}
        self.buses = {bus: Registry(of_bus) for bus, of_bus in (buses or {}).items()}
        for each in services:
            self.add(each)

    def add(self, service: S, kind: type[S] | None = None) -> S:
        """Add a service, to be found by its type, or by the more general ``kind``; return it."""
        kind = kind or type(service)
        if self._services.setdefault(kind, service) is not service:
            raise RuntimeError(f"two services of the type {kind.__qualname__}")
        return service

    def __getitem__(self, kind: type[S]) -> S:
        found = self._services[kind]
        assert isinstance(found, kind)
        return found

    def of_bus(self, bus: str) -> Registry:
        """Return the services of a configured bus. Raise Problem 404."""
        if bus not in self.buses:
            raise unknown_bus(bus, self.buses)
        return self.buses[bus]

    def of_buses(self, kind: type[S]) -> dict[str, S]:
        """Return the service of this type of each bus, by the name of the bus."""
        return {name: bus[kind] for name, bus in self.buses.items()}


def service_of(connection: HTTPConnection, kind: type[S]) -> S:
    services: Registry = connection.app.state.services
    return services[kind]


def bus_service_of(connection: HTTPConnection, bus: str, kind: type[S]) -> S:
    """Return the service of this type of a configured bus. Raise Problem 404."""
    services: Registry = connection.app.state.services
    return services.of_bus(bus)[kind]


def looked_up(find: Callable[[HTTPConnection], Any]) -> Any:
    """Return ``Depends(find)`` for a lookup that needs no thread: FastAPI would send a plain function to one
    and wait for it there, and between an operator's click and the wire there is no time for that."""

    async def look_up(connection: HTTPConnection) -> Any:
        return find(connection)

    return Depends(look_up)


def service(kind: type[Any]) -> Any:
    """Return a dependency of FastAPI: ``Keeper = Annotated[SetKeeper, service(SetKeeper)]``."""
    return looked_up(partial(service_of, kind=kind))


def bus_service(kind: type[Any]) -> Any:
    """Return a dependency of FastAPI that finds the service of this type of ``{bus}`` in the path, or raises
    Problem 404."""

    async def look_up(connection: HTTPConnection, bus: str) -> Any:
        return bus_service_of(connection, bus, kind)

    return Depends(look_up)
