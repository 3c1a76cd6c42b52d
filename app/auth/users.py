"""The admin's page of users, panels and tokens."""

from __future__ import annotations

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response

from app.auth.pages import FormText, Keeping, address_of
from app.auth.users_view import change_response, users_view
from app.web.access import Admin, role_named
from app.web.templating import render

router = APIRouter(include_in_schema=False)


@router.get("/users")
async def users_page(request: Request, _: Admin, accounts: Keeping) -> HTMLResponse:
    """Every user, and every token."""
    return await users_view(request, accounts)


@router.post("/users")
async def add_user(
    request: Request,
    person: Admin,
    accounts: Keeping,
    name: FormText = "",
    role: FormText = "viewer",
    password: FormText = "",
) -> Response:
    """A person, by password."""
    by, origin = person.name, address_of(request)
    add = accounts.add_user(name.strip(), role_named(role), password, by=by, origin=origin)
    return await change_response(request, accounts, add)


@router.post("/users/panels")
async def add_panel(
    request: Request,
    person: Admin,
    accounts: Keeping,
    panel: FormText = "",
    panel_role: FormText = "viewer",
    pin: FormText = "",
    home: FormText = "/",
) -> Response:
    """A panel on the wall, by PIN; it only looks unless it is given more."""
    by, origin = person.name, address_of(request)
    role, begins = role_named(panel_role), home.strip() or "/"
    add = accounts.add_panel(panel.strip(), role, pin, begins, by=by, origin=origin)
    return await change_response(request, accounts, add)


@router.post("/users/{name}/role")
async def set_role(
    request: Request, person: Admin, accounts: Keeping, name: str, role: FormText = ""
) -> Response:
    """Change the role of a user."""
    change = accounts.set_role(name, role_named(role), by=person.name, origin=address_of(request))
    return await change_response(request, accounts, change)


@router.post("/users/{name}/disable")
async def disable(request: Request, person: Admin, accounts: Keeping, name: str) -> Response:
    """Disable a user; every session ends."""
    change = accounts.set_disabled(name, True, by=person.name, origin=address_of(request))
    return await change_response(request, accounts, change)


@router.post("/users/{name}/enable")
async def enable(request: Request, person: Admin, accounts: Keeping, name: str) -> Response:
    """Enable a user again."""
    change = accounts.set_disabled(name, False, by=person.name, origin=address_of(request))
    return await change_response(request, accounts, change)


@router.post("/users/{name}/password")
async def reset_password(
    request: Request, person: Admin, accounts: Keeping, name: str, password: FormText = ""
) -> Response:
    """A new password (a PIN for a panel); every session ends."""
    reset = accounts.set_password(name, password, by=person.name, origin=address_of(request))
    return await change_response(request, accounts, reset)


@router.get("/users/{name}/remove")
async def review_removal(request: Request, _: Admin, name: str) -> HTMLResponse:
    """The consequences of removing a user, before it is done."""
    return render(request, "users/_review_remove.html", name=name)


@router.post("/users/{name}/remove")
async def remove(request: Request, person: Admin, accounts: Keeping, name: str) -> Response:
    """Remove a user, whose actions stay in the events."""
    return await change_response(
        request, accounts, accounts.remove_user(name, by=person.name, origin=address_of(request))
    )
