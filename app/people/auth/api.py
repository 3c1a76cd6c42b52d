"""``GET /me``: as whom a program or a page is signed in."""

from __future__ import annotations

from typing import Literal

from fastapi import APIRouter
from typing_extensions import TypedDict

from app.core.web.admission.access import Role, Viewer
from app.core.web.api.route import ApiRoute

router = APIRouter(prefix="/api/v1", tags=["who"], route_class=ApiRoute)


class CurrentUser(TypedDict):
    """The current user."""

    name: str
    role: Role
    via: Literal["session", "token", "worker", "demo"]


@router.get("/me")
async def get_current_user(person: Viewer) -> CurrentUser:
    """The current user: name and role."""
    assert person.via != "console"
    return {"name": person.name, "role": person.role, "via": person.via}
