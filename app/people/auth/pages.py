"""Signing in and out, and what one may change about oneself."""

from __future__ import annotations

from typing import Annotated
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, Form
from pydantic import AfterValidator
from starlette.background import BackgroundTask
from starlette.requests import Request
from starlette.responses import HTMLResponse, RedirectResponse, Response

from app.core.web.admission.access import Person, Viewer, address_of, caller_of, public
from app.core.web.admission.cookies import (
    SESSION,
    cookie_of,
    forget_cookie,
    is_encrypted,
    session_name,
    set_cookie,
)
from app.core.web.rendering.templating import render, templates_of
from app.core.web.services import service, service_of
from app.errors import Problem
from app.people.auth import rules
from app.people.auth.accounts import Accounts, check_has_own_password
from app.people.auth.acts import CHANGE_OWN_PASSWORD, LOG_OUT
from app.people.auth.oidc.login import MAX_AGE_S, NotAdmittedError, attempt_of, refusal_shown
from app.people.auth.oidc.single_sign_on import SingleSignOn
from app.people.auth.sign_in.first_admin import FirstAdmin, WrongCodeError
from app.people.auth.sign_in.signin import SignedIn, SignIn, WrongSecretError
from bus.errors import CallerError
from bus.messages import Message
from bus.text import composed

router = APIRouter(include_in_schema=False)


SignInService = Annotated[SignIn, service(SignIn)]
FirstAdminService = Annotated[FirstAdmin, service(FirstAdmin)]
AccountsService = Annotated[Accounts, service(Accounts)]
SingleSignOnService = Annotated[SingleSignOn, service(SingleSignOn)]
MAX_NAME = 64
"""The stored part of a typed name; no user has one so long."""
FormText = Annotated[str, Form()]
TypedName = Annotated[
    str, Form(), AfterValidator(lambda name: composed(name[: 4 * MAX_NAME].strip())[:MAX_NAME])
]
"""The name of a user or token; none is longer than MAX_NAME."""
DEVICE_COOKIE = "lineside_device"
"""Distinguishes a browser with an earlier sign-in from those of strangers; it signs no one in."""
DEVICE_KNOWN_S = 365 * rules.DAY
CALLBACK = "/login/oidc/callback"
ATTEMPT_COOKIE = "lineside_login"
"""What a browser keeps of a login by a company account that is under way."""
REAUTHENTICATE_COOKIE = "lineside_reauthenticate"
"""Of a browser in which someone has logged out: the next company account signs in at its provider again."""


@router.get("/login", dependencies=[Depends(public)])
async def login_page(
    request: Request,
    sign_in: SignInService,
    next: str = "/",
    panel: bool = False,
    refused: bool = False,
    company_account: str = "",
) -> Response:
    """The form; a signed-in user is redirected. ``refused``: an action has led here; ``company_account``: why
    a company account was not admitted."""
    if caller_of(request):
        return RedirectResponse(own_path(next), 303)
    return await _login_form(
        request, sign_in, next, panel, refused=refused, company_refusal=refusal_shown(company_account)
    )


@router.post("/login", dependencies=[Depends(public)])
async def log_in(
    request: Request,
    sign_in: SignInService,
    name: TypedName = "",
    password: FormText = "",
    next: FormText = "/",
) -> Response:
    """A person, by password."""
    return await _sign_in(request, sign_in, name, password, next, panel=False)


@router.post("/login/panel", dependencies=[Depends(public)])
async def log_panel_in(
    request: Request, sign_in: SignInService, name: TypedName = "", pin: FormText = "", next: FormText = "/"
) -> Response:
    """A panel on the wall, by PIN."""
    return await _sign_in(request, sign_in, name, pin, next, panel=True)


@router.get("/login/oidc", dependencies=[Depends(public)])
async def begin_login(request: Request, single_sign_on: SingleSignOnService, next: str = "/") -> Response:
    """Redirect to the provider; a signed-in user to the page. After a log-out here the person signs in there
    again: a panel or a PC may be shared, and the provider may know the last one still."""
    if caller_of(request):
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


@router.get("/setup", dependencies=[Depends(public)])
async def setup_page(request: Request, first_admin: FirstAdminService) -> Response:
    """The form for the first admin; redirected once there is a user."""
    return _setup_form(request) if await first_admin.is_open() else RedirectResponse("/login", 303)


@router.post("/setup", dependencies=[Depends(public)])
async def create_first_admin(
    request: Request,
    first_admin: FirstAdminService,
    sign_in: SignInService,
    code: FormText = "",
    name: TypedName = "",
    password: FormText = "",
    again: FormText = "",
) -> Response:
    """Create the first admin by the code that the server printed, and log in."""
    address = address_of(request)
    try:
        await first_admin.create(code, name, password, again, address)
    except Problem as problem:
        form = _setup_form(request, problem, code, name)
        if isinstance(problem, WrongCodeError):
            form.background = BackgroundTask(first_admin.note_refusal, address)
        return form
    except CallerError as fault:
        return _setup_form(request, Problem(422, "invalid", fault.message), code, name)
    return await _sign_in(request, sign_in, name, password, "/", panel=False)


@router.post("/logout")
async def log_out(
    request: Request, person: Annotated[Person, LOG_OUT.permitted], sign_in: SignInService
) -> Response:
    """End the session and forget the cookie."""
    name = session_name(request)
    cookie = request.cookies.get(name)
    if cookie:
        await sign_in.sign_out(cookie, person)
    response = RedirectResponse("/login", 303)
    response.delete_cookie(name, path="/", secure=is_encrypted(request))
    if service_of(request, SingleSignOn).settings is not None:
        set_cookie(request, response, REAUTHENTICATE_COOKIE, "true", DEVICE_KNOWN_S)
    return response


@router.get("/account")
async def account_page(request: Request, _: Viewer, done: str = "") -> HTMLResponse:
    """One's own language and password."""
    return _account(request, done=done)


@router.post("/account/language")
async def choose_language(
    request: Request, person: Viewer, accounts: AccountsService, language: FormText = ""
) -> Response:
    """Store the language that the user chose; empty: that of the browser."""
    if language and language not in templates_of(request).languages:
        raise CallerError(Message.of("no_such_language", language=language[:40]))
    await accounts.set_language(person, language)
    return RedirectResponse("/account?done=language", 303)


@router.post("/account/password")
async def change_password(
    request: Request,
    person: Annotated[Person, CHANGE_OWN_PASSWORD.permitted],
    accounts: AccountsService,
    sign_in: SignInService,
    present: FormText = "",
    password: FormText = "",
    again: FormText = "",
) -> Response:
    """Change the own password; every other session of the user ends."""
    check_has_own_password(person)
    this_one = rules.secret_hash(request.cookies[session_name(request)])
    try:
        await sign_in.check_present(person.name, present, address_of(request), device_of(request))
        if composed(password) != composed(again):
            raise CallerError(Message("new_passwords_differ"))
        await accounts.change_own_password(password, by=person, keep=this_one)
    except CallerError as fault:
        return _account(request, fault=fault)
    return RedirectResponse("/account?done=password", 303)


async def _sign_in(
    request: Request, sign_in: SignIn, name: str, secret: str, next: str, *, panel: bool
) -> Response:
    device = device_of(request)
    try:
        begun = await sign_in.sign_in(name, secret, address_of(request), panel=panel, device=device)
    except Problem as problem:
        form = await _login_form(request, sign_in, next, panel, problem=problem, name=name)
        if isinstance(problem, WrongSecretError):
            form.background = BackgroundTask(sign_in.note_refusal, name, address_of(request))
        return form
    return await signed_in(request, sign_in, begun, next)


async def signed_in(request: Request, sign_in: SignIn, begun: SignedIn, next_page: str) -> Response:
    """Redirect to the page that was wanted, with the cookies of the session. The session that the browser had
    before ends: nothing else could end it any more."""
    before = caller_of(request)
    if before is not None and before.via == "session":
        await sign_in.sign_out(request.cookies[session_name(request)], before.granted(LOG_OUT.role))
    home = begun.user.home if next_page == "/" else next_page
    response = RedirectResponse(own_path(home), 303)
    set_cookie(request, response, SESSION, begun.session, sign_in.lifetime_of(begun.user).absolute_s)
    set_cookie(request, response, DEVICE_COOKIE, begun.device, DEVICE_KNOWN_S)
    return response


def device_of(request: Request) -> str:
    """The cookie of a browser with an earlier sign-in; empty for an invalid one."""
    device = cookie_of(request, DEVICE_COOKIE)
    return device if len(device) == rules.SECRET_LENGTH and device.isascii() else ""


async def _login_form(
    request: Request,
    sign_in: SignIn,
    next: str,
    panel: bool,
    problem: Problem | None = None,
    name: str = "",
    *,
    refused: bool = False,
    company_refusal: Message | None = None,
) -> HTMLResponse:
    single_sign_on = service_of(request, SingleSignOn)
    return render(
        request,
        "auth/login.html",
        status=problem.status if problem else 200,
        headers=problem.headers if problem else None,
        next=own_path(next),
        panel=panel,
        problem=problem,
        name=name,
        refused=refused,
        has_company_accounts=single_sign_on.settings is not None,
        company_refusal=company_refusal,
        provider_fault=single_sign_on.fault,
        no_users=await sign_in.has_no_users(),
        has_code=bool(service_of(request, FirstAdmin).code),
    )


def _callback_url(request: Request) -> str:
    """As the browser reaches this server, which the provider compares with those it knows."""
    return f"{request.url.scheme}://{request.url.netloc}{CALLBACK}"


def _back_to_login(refused: NotAdmittedError, next_page: str) -> Response:
    query: dict[str, str] = {"company_account": refused.reason}
    if own_path(next_page) != "/":
        query["next"] = next_page
    return RedirectResponse(f"/login?{urlencode(query)}", 303)


def _setup_form(
    request: Request, problem: Problem | None = None, code: str = "", name: str = ""
) -> HTMLResponse:
    return render(
        request,
        "auth/setup.html",
        status=problem.status if problem else 200,
        headers=problem.headers if problem else None,
        problem=problem,
        code=code[:MAX_NAME],
        name=name,
    )


def _account(request: Request, *, done: str = "", fault: CallerError | None = None) -> HTMLResponse:
    return render(request, "auth/account.html", status=422 if fault else 200, done=done, fault=fault)


def own_path(path: str) -> str:
    """The path, where it is of this server; else that of the first page."""
    return path if rules.is_own_path(path) else "/"
