"""How a route reaches one of the app's services, by the name that it has among them."""

from __future__ import annotations

from typing import Any

from fastapi import Depends, Request


def service(name: str) -> Any:
    """A dependency of FastAPI: ``Keeper = Annotated[SetKeeper, service("sets")]``."""

    def find(request: Request) -> Any:
        return getattr(request.app.state.services, name)

    return Depends(find)
