"""The way to the provider, and back."""

from __future__ import annotations

from typing import Annotated
from urllib.parse import urlencode

from fastapi import APIRouter, Depends
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from app.auth.oidc.login_attempt import MAX_AGE_S, attempt_of
from app.auth.oidc.refusal import NotAdmittedError
from app.auth.oidc.single_sign_on import SingleSignOn
from app.auth.pages import REAUTHENTICATE_COOKIE, SignInService, device_of, own_path, signed_in
from app.web.admission.access import address_of, person_of, public
from app.web.admission.cookies import cookie_of, forget_cookie, set_cookie
from app.web.services import service

router = APIRouter(include_in_schema=False)

BEGIN = "/login/oidc"
CALLBACK = "/login/oidc/callback"
ATTEMPT_COOKIE = "lineside_login"
SingleSignOnService = Annotated[SingleSignOn, service(SingleSignOn)]


@router.get(BEGIN, dependencies=[Depends(public)])
async def begin_login(request: Request, single_sign_on: SingleSignOnService, next: str = "/") -> Response:
    """Redirect to the provider; a signed-in user to the page. After a log-out here the person signs in there
    again: a panel or a PC may be shared, and the provider may know the last one still."""
    if person_of(request):
        return RedirectResponse(own_path(next), 303)
    has_logged_out = bool(cookie_of(request, REAUTHENTICATE_COOKIE))
    try:
        url, attempt = single_sign_on.begin(next, _callback_url(request), reauthenticate=has_logged_out)
    except NotAdmittedError as refused:
        return _back_to_login(refused, next)
    response = RedirectResponse(url, 303)
    set_cookie(request, response, ATTEMPT_COOKIE, attempt.to_cookie(), MAX_AGE_S)
    return response


@router.get(CALLBACK, dependencies=[Depends(public)])
async def finish_login(
    request: Request, single_sign_on: SingleSignOnService, sign_in: SignInService
) -> Response:
    """Begin the session of a browser that the provider sends back. What was refused is shown by the login
    page: this address has a code in it, and is not to be loaded again."""
    attempt = attempt_of(cookie_of(request, ATTEMPT_COOKIE))
    try:
        begun = await single_sign_on.finish(
            attempt,
            dict(request.query_params),
            _callback_url(request),
            address=address_of(request),
            device=device_of(request),
        )
    except NotAdmittedError as refused:
        response = _back_to_login(refused, "/" if attempt is None else attempt.next)
    else:
        assert attempt is not None
        response = await signed_in(request, sign_in, begun, attempt.next)
        forget_cookie(request, response, REAUTHENTICATE_COOKIE)
    forget_cookie(request, response, ATTEMPT_COOKIE)
    return response


def _callback_url(request: Request) -> str:
    """As the browser reaches this server, which the provider compares with those it knows."""
    return f"{request.url.scheme}://{request.url.netloc}{CALLBACK}"


def _back_to_login(refused: NotAdmittedError, next_page: str) -> Response:
    query: dict[str, str] = {"company_account": refused.reason}
    if own_path(next_page) != "/":
        query["next"] = next_page
    return RedirectResponse(f"/login?{urlencode(query)}", 303)
