"""The admin's page of tokens: creating and revoking them."""

from __future__ import annotations

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response

from app.auth.pages import FormText, Keeping, address_of
from app.auth.users_view import change_response, users_view
from app.web.access import Admin, Role, role_named
from app.web.templating import render
from bus.errors import CallerError
from bus.messages import Message

router = APIRouter(include_in_schema=False)


@router.post("/users/tokens")
async def create_token(
    request: Request,
    person: Admin,
    accounts: Keeping,
    token: FormText = "",
    token_role: FormText = "viewer",
    token_bus: FormText = "",
    expires: FormText = "",
) -> HTMLResponse:
    """The token is in this one response and nowhere else."""
    try:
        secret = await accounts.create_token(
            token.strip(),
            role_named(token_role, Role),
            bus=token_bus,
            expires_days=_days(expires),
            by=person.name,
            origin=address_of(request),
        )
    except CallerError as error:
        return await users_view(request, accounts, fault=error)
    return await users_view(request, accounts, token_name=token.strip(), token=secret)


@router.get("/users/tokens/{name}/revoke")
async def review_revocation(request: Request, _: Admin, accounts: Keeping, name: str) -> HTMLResponse:
    """What revoking a token means, and whether a program has been using it, before it is done."""
    token = next((token for token in await accounts.tokens() if token.name == name), None)
    return render(request, "users/_review_revoke.html", name=name, used_at=token.used_at if token else None)


@router.post("/users/tokens/{name}/revoke")
async def revoke_token(request: Request, person: Admin, accounts: Keeping, name: str) -> Response:
    """It is refused from the next request on."""
    return await change_response(
        request, accounts, accounts.revoke_token(name, by=person.name, origin=address_of(request))
    )


def _days(typed: str) -> int | None:
    """What was typed as a number of days; None for nothing. Raises CallerError."""
    text = typed.strip()
    if not text:
        return None
    if not text.isdecimal() or len(text) > 4:
        raise CallerError(Message("token_days_malformed"))
    return int(text)
