"""The admin's page of users, panels and tokens."""

from __future__ import annotations

from collections.abc import Awaitable
from typing import Annotated

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import HTMLResponse, RedirectResponse, Response

from app.auth import acts
from app.auth.accounts import Accounts
from app.auth.pages import AccountsService, FormText, address_of
from app.server.encryption import Encryption
from app.web.access import PEOPLE_ROLES, Admin, Person, Role, role_named
from app.web.problems import is_fragment
from app.web.services import service_of
from app.web.templating import render
from bus.errors import CallerError
from bus.messages import Message


async def users_view(
    request: Request,
    accounts: Accounts,
    *,
    fault: CallerError | None = None,
    token_name: str = "",
    token: str = "",
) -> HTMLResponse:
    """Every user and every token; ``fault``: why a change was refused; ``token``: the secret
    of the one just created, ``token_name``, which is shown once."""
    return render(
        request,
        "users/page.html",
        status=422 if fault else 200,
        users=await accounts.users(),
        tokens=await accounts.tokens(),
        roles=PEOPLE_ROLES,
        buses=accounts.buses,
        now=accounts.now(),
        fault=fault,
        encryption_fault=service_of(request, Encryption).fault,
        token_name=token_name,
        token=token,
    )


async def change_response(request: Request, accounts: Accounts, change: Awaitable[None]) -> Response:
    """Back to the page; with the reason on it, or in the dialog, when the change was refused."""
    in_dialog = is_fragment(request)
    try:
        await change
    except CallerError as error:
        if in_dialog:
            raise
        return await users_view(request, accounts, fault=error)
    return Response(headers={"HX-Redirect": "/users"}) if in_dialog else RedirectResponse("/users", 303)


router = APIRouter(include_in_schema=False)


@router.get("/users")
async def users_page(request: Request, _: Admin, accounts: AccountsService) -> HTMLResponse:
    """Every user, and every token."""
    return await users_view(request, accounts)


@router.post("/users")
async def add_user(
    request: Request,
    person: Annotated[Person, acts.ADD_USER.permitted],
    accounts: AccountsService,
    name: FormText = "",
    role: FormText = "viewer",
    password: FormText = "",
) -> Response:
    """Add a person, who signs in by password."""
    add = accounts.add_user(name.strip(), role_named(role), password, by=person, origin=address_of(request))
    return await change_response(request, accounts, add)


@router.post("/users/panels")
async def add_panel(
    request: Request,
    person: Annotated[Person, acts.ADD_PANEL.permitted],
    accounts: AccountsService,
    panel: FormText = "",
    panel_role: FormText = "viewer",
    pin: FormText = "",
    home: FormText = "/",
) -> Response:
    """Add a panel on the wall, which signs in by PIN; it is a viewer unless it is given another role."""
    role, begins = role_named(panel_role), home.strip() or "/"
    add = accounts.add_panel(panel.strip(), role, pin, begins, by=person, origin=address_of(request))
    return await change_response(request, accounts, add)


@router.post("/users/{name}/role")
async def set_role(
    request: Request,
    person: Annotated[Person, acts.SET_ROLE.permitted],
    accounts: AccountsService,
    name: str,
    role: FormText = "",
) -> Response:
    """Change the role of a user."""
    change = accounts.set_role(name, role_named(role), by=person, origin=address_of(request))
    return await change_response(request, accounts, change)


@router.post("/users/{name}/disable")
async def disable(
    request: Request,
    person: Annotated[Person, acts.DISABLE_USER.permitted],
    accounts: AccountsService,
    name: str,
) -> Response:
    """Disable a user; every session ends."""
    change = accounts.set_disabled(name, True, by=person, origin=address_of(request))
    return await change_response(request, accounts, change)


@router.post("/users/{name}/enable")
async def enable(
    request: Request,
    person: Annotated[Person, acts.ENABLE_USER.permitted],
    accounts: AccountsService,
    name: str,
) -> Response:
    """Enable a user again."""
    change = accounts.set_disabled(name, False, by=person, origin=address_of(request))
    return await change_response(request, accounts, change)


@router.post("/users/{name}/password")
async def reset_password(
    request: Request,
    person: Annotated[Person, acts.SET_PASSWORD.permitted],
    accounts: AccountsService,
    name: str,
    password: FormText = "",
) -> Response:
    """Set a new password, or the PIN of a panel; every session of the user ends."""
    reset = accounts.set_password(name, password, by=person, origin=address_of(request))
    return await change_response(request, accounts, reset)


@router.get("/users/{name}/remove")
async def review_removal(request: Request, _: Admin, name: str) -> HTMLResponse:
    """The consequences of removing a user, before it is done."""
    return render(request, "users/_review_remove.html", name=name)


@router.post("/users/{name}/remove")
async def remove(
    request: Request,
    person: Annotated[Person, acts.REMOVE_USER.permitted],
    accounts: AccountsService,
    name: str,
) -> Response:
    """Remove a user, whose actions stay in the events."""
    return await change_response(
        request, accounts, accounts.remove_user(name, by=person, origin=address_of(request))
    )


@router.post("/users/tokens")
async def create_token(
    request: Request,
    person: Annotated[Person, acts.CREATE_TOKEN.permitted],
    accounts: AccountsService,
    token: FormText = "",
    token_role: FormText = "viewer",
    token_bus: FormText = "",
    expires: FormText = "",
) -> HTMLResponse:
    """Create a token, which is in this one response and nowhere else."""
    try:
        secret = await accounts.create_token(
            token.strip(),
            role_named(token_role, Role),
            bus=token_bus,
            expires_days=_days(expires),
            by=person,
            origin=address_of(request),
        )
    except CallerError as error:
        return await users_view(request, accounts, fault=error)
    return await users_view(request, accounts, token_name=token.strip(), token=secret)


@router.get("/users/tokens/{name}/revoke")
async def review_revocation(request: Request, _: Admin, accounts: AccountsService, name: str) -> HTMLResponse:
    """What revoking a token means, and whether a program has been using it, before it is done."""
    token = next((token for token in await accounts.tokens() if token.name == name), None)
    return render(request, "users/_review_revoke.html", name=name, used_at=token.used_at if token else None)


@router.post("/users/tokens/{name}/revoke")
async def revoke_token(
    request: Request,
    person: Annotated[Person, acts.REVOKE_TOKEN.permitted],
    accounts: AccountsService,
    name: str,
) -> Response:
    """Revoke a token, which is refused from the next request on."""
    return await change_response(
        request, accounts, accounts.revoke_token(name, by=person, origin=address_of(request))
    )


def _days(typed: str) -> int | None:
    """What was typed as a number of days; None for nothing. Raises CallerError."""
    text = typed.strip()
    if not text:
        return None
    if not text.isdecimal() or len(text) > 4:
        raise CallerError(Message("token_days_malformed"))
    return int(text)
