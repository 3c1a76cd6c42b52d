"""The admin's page of users, panels and tokens."""

from __future__ import annotations

from collections.abc import Awaitable
from dataclasses import dataclass
from typing import Annotated

from fastapi import APIRouter
from starlette.requests import HTTPConnection
from starlette.responses import HTMLResponse, RedirectResponse, Response

from app.core.server.tls import Encryption
from app.core.web.admission.access import PEOPLE_ROLES, Admin, Person, Role, role_named
from app.core.web.problems import is_fragment
from app.core.web.rendering.templating import render
from app.core.web.services import looked_up, service_of
from app.people.auth import acts
from app.people.auth.accounts import Accounts
from app.people.auth.pages import FormText, TypedName
from bus.errors import CallerError
from bus.messages import Message

router = APIRouter(include_in_schema=False)


@dataclass(frozen=True, slots=True)
class UsersPage:
    """The page in one request, and the accounts that it shows and changes."""

    request: HTTPConnection
    accounts: Accounts

    async def render(
        self, *, fault: CallerError | None = None, token_name: str = "", token: str = ""
    ) -> HTMLResponse:
        """Every user and every token; ``fault``: why a change was refused; ``token``: the secret
        of the one just created, ``token_name``, which is shown once."""
        return render(
            self.request,
            "users/page.html",
            status=422 if fault else 200,
            users=await self.accounts.users(),
            tokens=await self.accounts.tokens(),
            roles=PEOPLE_ROLES,
            buses=self.accounts.buses,
            fault=fault,
            encryption_fault=service_of(self.request, Encryption).fault,
            token_name=token_name,
            token=token,
        )

    async def after(self, change: Awaitable[None]) -> Response:
        """Back to the page; with the reason on it, or in the dialog, when the change was refused."""
        in_dialog = is_fragment(self.request)
        try:
            await change
        except CallerError as error:
            if in_dialog:
                raise
            return await self.render(fault=error)
        return Response(headers={"HX-Redirect": "/users"}) if in_dialog else RedirectResponse("/users", 303)


OfUsers = Annotated[
    UsersPage, looked_up(lambda connection: UsersPage(connection, service_of(connection, Accounts)))
]


@router.get("/users")
async def users_page(_: Admin, page: OfUsers) -> HTMLResponse:
    """Every user, and every token."""
    return await page.render()


@router.post("/users")
async def add_user(
    by: Annotated[Person, acts.ADD_USER.permitted],
    page: OfUsers,
    name: TypedName = "",
    role: FormText = "viewer",
    password: FormText = "",
) -> Response:
    """Add a person, who signs in by password."""
    return await page.after(page.accounts.add_user(name, role_named(role), password, by=by))


@router.post("/users/panels")
async def add_panel(
    by: Annotated[Person, acts.ADD_PANEL.permitted],
    page: OfUsers,
    panel: TypedName = "",
    panel_role: FormText = "viewer",
    pin: FormText = "",
    home: FormText = "/",
) -> Response:
    """Add a panel on the wall, which signs in by PIN; it is a viewer unless it is given another role."""
    role, begins = role_named(panel_role), home.strip() or "/"
    return await page.after(page.accounts.add_panel(panel, role, pin, begins, by=by))


@router.post("/users/{name}/role")
async def set_role(
    by: Annotated[Person, acts.SET_ROLE.permitted], page: OfUsers, name: str, role: FormText = ""
) -> Response:
    """Change the role of a user."""
    return await page.after(page.accounts.set_role(name, role_named(role), by=by))


@router.post("/users/{name}/disable")
async def disable(by: Annotated[Person, acts.DISABLE_USER.permitted], page: OfUsers, name: str) -> Response:
    """Disable a user; every session ends."""
    return await page.after(page.accounts.set_disabled(name, True, by=by))


@router.post("/users/{name}/enable")
async def enable(by: Annotated[Person, acts.ENABLE_USER.permitted], page: OfUsers, name: str) -> Response:
    """Enable a user again."""
    return await page.after(page.accounts.set_disabled(name, False, by=by))


@router.post("/users/{name}/password")
async def reset_password(
    by: Annotated[Person, acts.SET_PASSWORD.permitted], page: OfUsers, name: str, password: FormText = ""
) -> Response:
    """Set a new password, or the PIN of a panel; every session of the user ends."""
    return await page.after(page.accounts.set_password(name, password, by=by))


@router.get("/users/{name}/remove")
async def review_removal(_: Admin, page: OfUsers, name: str) -> HTMLResponse:
    """The consequences of removing a user, before it is done."""
    found = next((user for user in await page.accounts.users() if user.name == name), None)
    has_company_account = found is not None and found.company_account is not None
    return render(
        page.request, "users/_review_remove.html", name=name, has_company_account=has_company_account
    )


@router.post("/users/{name}/remove")
async def remove(by: Annotated[Person, acts.REMOVE_USER.permitted], page: OfUsers, name: str) -> Response:
    """Remove a user, whose actions stay in the events."""
    return await page.after(page.accounts.remove_user(name, by=by))


@router.post("/users/tokens")
async def create_token(
    by: Annotated[Person, acts.CREATE_TOKEN.permitted],
    page: OfUsers,
    token: TypedName = "",
    token_role: FormText = "viewer",
    token_bus: FormText = "",
    expires: FormText = "",
) -> HTMLResponse:
    """Create a token, which is in this one response and nowhere else."""
    create = page.accounts.create_token
    try:
        role, days = role_named(token_role, Role), _days(expires)
        secret = await create(token, role, bus=token_bus, expires_days=days, by=by)
    except CallerError as error:
        return await page.render(fault=error)
    return await page.render(token_name=token, token=secret)


@router.get("/users/tokens/{name}/revoke")
async def review_revocation(_: Admin, page: OfUsers, name: str) -> HTMLResponse:
    """What revoking a token means, and whether a program has been using it, before it is done."""
    token = next((token for token in await page.accounts.tokens() if token.name == name), None)
    used_at = token.used_at if token else None
    return render(page.request, "users/_review_revoke.html", name=name, used_at=used_at)


@router.post("/users/tokens/{name}/revoke")
async def revoke_token(
    by: Annotated[Person, acts.REVOKE_TOKEN.permitted], page: OfUsers, name: str
) -> Response:
    """Revoke a token, which is refused from the next request on."""
    return await page.after(page.accounts.revoke_token(name, by=by))


def _days(typed: str) -> int | None:
    """What was typed as a number of days; None for nothing. Raises CallerError."""
    text = typed.strip()
    if not text:
        return None
    if not text.isdecimal() or len(text) > 4:
        raise CallerError(Message("token_days_malformed"))
    return int(text)
