"""The page of users and tokens, and the response to a change of them."""

from __future__ import annotations

from collections.abc import Awaitable

from starlette.requests import Request
from starlette.responses import HTMLResponse, RedirectResponse, Response

from app.auth.accounts import Accounts
from app.web.access import PEOPLE_ROLES
from app.web.problems import is_fragment
from app.web.templating import render
from bus.errors import CallerError


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
