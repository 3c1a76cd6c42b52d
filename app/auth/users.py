"""The admin's page of users, panels and tokens."""

from __future__ import annotations

from collections.abc import Awaitable

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import HTMLResponse, RedirectResponse, Response

from app.auth import rules
from app.auth.accounts import Accounts
from app.auth.pages import Keeping, Text, address_of
from app.errors import Problem
from app.web.access import PEOPLE_ROLES, Admin, Person, Role, Viewer, role_named
from app.web.problems import is_fragment
from app.web.templating import render
from bus.errors import CallerError

router = APIRouter(include_in_schema=False)


@router.get("/api/v1/me", include_in_schema=True, tags=["who"])
async def me(person: Viewer) -> dict[str, str]:
    """Who asks, by name and role."""
    return {"name": person.name, "role": str(person.role), "via": person.via}


@router.get("/users")
async def users_page(request: Request, _: Admin, accounts: Keeping) -> HTMLResponse:
    """Everybody who may sign in, and every token."""
    return await _page(request, accounts)


@router.post("/users")
async def add_user(
    request: Request,
    person: Admin,
    accounts: Keeping,
    name: Text = "",
    role: Text = "viewer",
    password: Text = "",
) -> Response:
    """A person, by password."""
    origin = address_of(request)

    async def add() -> None:
        rules.check_password(password)
        await accounts.add_user(name.strip(), role_named(role), password, by=person.name, origin=origin)

    return await _did(request, accounts, add())


@router.post("/users/panels")
async def add_panel(
    request: Request,
    person: Admin,
    accounts: Keeping,
    panel: Text = "",
    panel_role: Text = "viewer",
    pin: Text = "",
    home: Text = "/",
) -> Response:
    """A panel on the wall, by PIN; it only looks unless it is given more."""
    by, origin = person.name, address_of(request)
    role, begins = role_named(panel_role), home.strip() or "/"
    add = accounts.add_panel(panel.strip(), role, pin, begins, by=by, origin=origin)
    return await _did(request, accounts, add)


@router.post("/users/{name}/role")
async def set_role(
    request: Request, person: Admin, accounts: Keeping, name: str, role: Text = ""
) -> Response:
    """What somebody may do from now on."""
    change = accounts.set_role(name, role_named(role), by=person.name, origin=address_of(request))
    return await _did(request, accounts, change)


@router.post("/users/{name}/disable")
async def disable(request: Request, person: Admin, accounts: Keeping, name: str) -> Response:
    """Refuse somebody from now on; every session ends."""
    change = accounts.set_disabled(name, True, by=person.name, origin=address_of(request))
    return await _did(request, accounts, change)


@router.post("/users/{name}/enable")
async def enable(request: Request, person: Admin, accounts: Keeping, name: str) -> Response:
    """Admit somebody again."""
    change = accounts.set_disabled(name, False, by=person.name, origin=address_of(request))
    return await _did(request, accounts, change)


@router.post("/users/{name}/password")
async def reset_password(
    request: Request, person: Admin, accounts: Keeping, name: str, password: Text = ""
) -> Response:
    """A new password (a PIN for a panel); every session ends."""
    return await _did(request, accounts, _reset(accounts, person, name, password, address_of(request)))


@router.get("/users/{name}/remove")
async def review_removal(request: Request, _: Admin, name: str) -> HTMLResponse:
    """What removing somebody means, before it is done."""
    return render(request, "users/_review_remove.html", name=name)


@router.post("/users/{name}/remove")
async def remove(request: Request, person: Admin, accounts: Keeping, name: str) -> Response:
    """What somebody did stays in the events."""
    return await _did(
        request, accounts, accounts.remove_user(name, by=person.name, origin=address_of(request))
    )


@router.post("/users/tokens")
async def create_token(
    request: Request, person: Admin, accounts: Keeping, token: Text = "", token_role: Text = "viewer"
) -> HTMLResponse:
    """The token is on this one answer and nowhere else."""
    try:
        chosen = role_named(token_role, Role)
        secret = await accounts.create_token(
            token.strip(), chosen, by=person.name, origin=address_of(request)
        )
    except CallerError as error:
        return await _page(request, accounts, status=422, fault=error)
    return await _page(request, accounts, token_name=token.strip(), token=secret)


@router.get("/users/tokens/{name}/revoke")
async def review_revocation(request: Request, _: Admin, accounts: Keeping, name: str) -> HTMLResponse:
    """What revoking a token means, and whether a program has been using it, before it is done."""
    token = next((token for token in await accounts.tokens() if token.name == name), None)
    return render(request, "users/_review_revoke.html", name=name, used_at=token.used_at if token else None)


@router.post("/users/tokens/{name}/revoke")
async def revoke_token(request: Request, person: Admin, accounts: Keeping, name: str) -> Response:
    """It is refused from the next request on."""
    return await _did(
        request, accounts, accounts.revoke_token(name, by=person.name, origin=address_of(request))
    )


async def _did(request: Request, accounts: Accounts, change: Awaitable[None]) -> Response:
    """Back to the page; with the sentence on it, or in the dialog, when the change was refused."""
    in_dialog = is_fragment(request)
    try:
        await change
    except CallerError as error:
        if in_dialog:
            raise Problem(422, "invalid", error.template, params=error.params) from error
        return await _page(request, accounts, status=422, fault=error)
    return Response(headers={"HX-Redirect": "/users"}) if in_dialog else RedirectResponse("/users", 303)


async def _reset(accounts: Accounts, person: Person, name: str, password: str, origin: str) -> None:
    user = next((user for user in await accounts.users() if user.name == name), None)
    (rules.check_pin if user and user.panel else rules.check_password)(password)
    await accounts.set_password(name, password, by=person.name, origin=origin)


async def _page(
    request: Request,
    accounts: Accounts,
    *,
    status: int = 200,
    fault: CallerError | None = None,
    token_name: str = "",
    token: str = "",
) -> HTMLResponse:
    return render(
        request,
        "users/page.html",
        status=status,
        users=await accounts.users(),
        tokens=await accounts.tokens(),
        roles=PEOPLE_ROLES,
        fault=fault,
        token_name=token_name,
        token=token,
    )
