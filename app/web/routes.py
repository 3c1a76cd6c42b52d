"""The rule that nothing is open by accident: every route names a role or says that it is public."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from fastapi import FastAPI
from fastapi.routing import RouteContext, iter_route_contexts

from app.web.access import Requires, Role, public


def _calls(dependant: Any) -> Iterator[Any]:
    for dependency in dependant.dependencies:
        yield dependency.call
        yield from _calls(dependency)


def _roles(route: RouteContext) -> Iterator[Role | None]:
    dependant = getattr(route, "dependant", None)
    for call in _calls(dependant) if dependant is not None else ():
        if isinstance(call, Requires):
            yield call.role
        elif call is public:
            yield None


def demands(app: FastAPI) -> list[tuple[RouteContext, set[Role | None]]]:
    """What each route demands; ``None`` stands for public, an empty set for one that says nothing."""
    return [(route, set(_roles(route))) for route in iter_route_contexts(app.routes)]


def refuse_undeclared(app: FastAPI) -> None:
    """Raises RuntimeError naming the first route that declares neither a role nor that it is public."""
    for route, roles in demands(app):
        if not roles:
            raise RuntimeError(f"{route.path} declares no role: add Requires(Role.…) or public to it")
