"""Pages of signing in and out, of one's own account, and of all accounts for an admin; and ``GET /me``."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Awaitable, Mapping
from dataclasses import dataclass
from typing import Annotated, Literal
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, Form
from pydantic import AfterValidator
from starlette.background import BackgroundTask
from starlette.requests import HTTPConnection, Request
from starlette.responses import HTMLResponse, RedirectResponse, Response
from typing_extensions import TypedDict

from app.core.server.tls import Encryption
from app.core.web.access import (
    PEOPLE_ROLES,
    SESSION,
    Admin,
    Person,
    Role,
    Viewer,
    address_of,
    caller_of,
    cookie_of,
    forget_cookie,
    is_encrypted,
    public,
    role_named,
    session_name,
    set_cookie,
)
from app.core.web.api import ApiRoute
from app.core.web.problems import is_fragment
from app.core.web.result import result_of, send_to, shown_once
from app.core.web.routes import GuardedRoute
from app.core.web.services import looked_up, service, service_of
from app.core.web.templating import LANGUAGE_COOKIE, render, templates_of
from app.errors import Problem
from app.people.auth import rules
from app.people.auth.accounts import (
    ADD_PANEL,
    ADD_USER,
    CHANGE_OWN_PASSWORD,
    CREATE_TOKEN,
    DISABLE_USER,
    ENABLE_USER,
    LOG_OUT,
    REMOVE_USER,
    REVOKE_TOKEN,
    SET_PASSWORD,
    SET_ROLE,
    Accounts,
    check_has_own_password,
)
from app.people.auth.login_attempt import MAX_AGE_S, NotAdmittedError, attempt_of, refusal_shown
from app.people.auth.sign_in import FirstAdmin, SignedIn, SignIn, WrongCodeError, WrongSecretError
from app.people.auth.single_sign_on import SingleSignOn
from bus.errors import CallerError
from bus.messages import Message
from bus.validation import composed

router = APIRouter(include_in_schema=False, route_class=GuardedRoute)


SignInService = Annotated[SignIn, service(SignIn)]
FirstAdminService = Annotated[FirstAdmin, service(FirstAdmin)]
AccountsService = Annotated[Accounts, service(Accounts)]
SingleSignOnService = Annotated[SingleSignOn, service(SingleSignOn)]
MAX_NAME = 64
"""The most characters of a typed name that are stored; no user has a longer name."""
FormText = Annotated[str, Form()]
TypedName = Annotated[
    str, Form(), AfterValidator(lambda name: composed(name[: 4 * MAX_NAME].strip())[:MAX_NAME])
]
"""The name of a user or token; none is longer than MAX_NAME."""
DEVICE_COOKIE = "lineside_device"
"""A cookie that distinguishes a browser with an earlier sign-in from strangers'; it signs no one in."""
DEVICE_KNOWN_S = 365 * rules.DAY
CALLBACK = "/login/oidc/callback"
ATTEMPT_COOKIE = "lineside_login"
"""The cookie in which a browser keeps its attempt to log in by a company account."""
REAUTHENTICATE_COOKIE = "lineside_reauthenticate"
"""The cookie of a browser in which someone has logged out: its next company account signs in there again."""


@router.get("/login", dependencies=[Depends(public)])
async def login_page(
    request: Request,
    sign_in: SignInService,
    next: str = "/",
    panel: bool = False,
    refused: bool = False,
    company_account: str = "",
) -> Response:
    """Show the form, or redirect a signed-in user. ``refused``: whether an action has led here;
    ``company_account``: why a company account was not admitted."""
    if caller_of(request):
        return RedirectResponse(_own_path(next), 303)
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
    """Sign in a person by password."""
    return await _sign_in(request, sign_in, name, password, next, panel=False)


@router.post("/login/panel", dependencies=[Depends(public)])
async def log_panel_in(
    request: Request, sign_in: SignInService, name: TypedName = "", pin: FormText = "", next: FormText = "/"
) -> Response:
    """Sign in a panel on the wall by its PIN."""
    return await _sign_in(request, sign_in, name, pin, next, panel=True)


@router.get("/login/oidc", dependencies=[Depends(public)])
async def begin_login(request: Request, single_sign_on: SingleSignOnService, next: str = "/") -> Response:
    """Redirect to the provider, or a signed-in user to the page ``next``. After a log-out in this browser the
    provider requests the password again, because others may use the browser too."""
    if caller_of(request):
        return RedirectResponse(_own_path(next), 303)
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
    """Begin the session of a browser that the provider sends back. A refusal is shown by the login page: this
    address has a code in it, and is not to be loaded again."""
    attempt = attempt_of(cookie_of(request, ATTEMPT_COOKIE))
    try:
        begun = await single_sign_on.finish(
            attempt,
            dict(request.query_params),
            _callback_url(request),
            address=address_of(request),
            device=_device_of(request),
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
    """Show the form for the first admin, or redirect once there is a user."""
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
async def account_page(request: Request, _: Viewer) -> Response:
    """Show the forms for one's own language and password."""
    return shown_once(request, _account(request, done=result_of(request).get("done", "")))


@router.post("/account/language")
async def choose_language(
    request: Request, person: Viewer, accounts: AccountsService, language: FormText = "", back: FormText = ""
) -> Response:
    """Store the language that the user chose, empty: that of the browser, and return to the page ``back``.
    In a demo the browser keeps it."""
    if language and language not in templates_of(request).languages:
        raise CallerError(Message.of("no_such_language", language=language[:40]))
    response = (
        RedirectResponse(_own_path(back), 303) if back else send_to(request, "/account", done="language")
    )
    if person.via == "demo":
        set_cookie(request, response, LANGUAGE_COOKIE, language, DEVICE_KNOWN_S)
    else:
        await accounts.set_language(person, language)
    return response


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
    """Change the caller's own password; every other session of the user ends."""
    check_has_own_password(person)
    this_one = rules.secret_hash(request.cookies[session_name(request)])
    try:
        await sign_in.check_present(person.name, present, address_of(request), _device_of(request))
        if composed(password) != composed(again):
            raise CallerError(Message("new_passwords_differ"))
        await accounts.change_own_password(password, by=person, keep=this_one)
    except CallerError as fault:
        return _account(request, fault=fault)
    return send_to(request, "/account", done="password")


async def _sign_in(
    request: Request, sign_in: SignIn, name: str, secret: str, next: str, *, panel: bool
) -> Response:
    device = _device_of(request)
    try:
        begun = await sign_in.sign_in(name, secret, address_of(request), panel=panel, device=device)
    except Problem as problem:
        form = await _login_form(request, sign_in, next, panel, problem=problem, name=name)
        if isinstance(problem, WrongSecretError):
            form.background = BackgroundTask(sign_in.note_refusal, name, address_of(request))
        return form
    return await signed_in(request, sign_in, begun, next)


async def signed_in(request: Request, sign_in: SignIn, begun: SignedIn, next_page: str) -> Response:
    """Redirect to the wanted page, with the cookies of the session. The earlier session of the browser ends:
    nothing else could end it."""
    before = caller_of(request)
    if before is not None and before.via == "session":
        await sign_in.sign_out(request.cookies[session_name(request)], before.granted(LOG_OUT.role))
    home = begun.user.home if next_page == "/" else next_page
    response = RedirectResponse(_own_path(home), 303)
    set_cookie(request, response, SESSION, begun.session, sign_in.lifetime_of(begun.user).absolute_s)
    set_cookie(request, response, DEVICE_COOKIE, begun.device, DEVICE_KNOWN_S)
    return response


def _device_of(request: Request) -> str:
    """Return the cookie of a browser with an earlier sign-in; empty for an invalid one."""
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
        next=_own_path(next),
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
    """Return the address to which the provider sends a browser back, as the browser reaches this server: the
    provider compares it with those it knows."""
    return f"{request.url.scheme}://{request.url.netloc}{CALLBACK}"


def _back_to_login(refused: NotAdmittedError, next_page: str) -> Response:
    query: dict[str, str] = {"company_account": refused.reason}
    if _own_path(next_page) != "/":
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


def _own_path(path: str) -> str:
    """Return the path if it is of this server, else that of the first page."""
    return path if rules.is_own_path(path) else "/"


@dataclass(frozen=True, slots=True)
class UsersPage:
    """The page of users in one request, and the accounts that it shows and changes."""

    request: HTTPConnection
    accounts: Accounts

    async def render(
        self,
        *,
        fault: CallerError | None = None,
        token_name: str = "",
        token: str = "",
        opened: str = "",
        typed: Mapping[str, str] | None = None,
        done: str = "",
        name: str = "",
    ) -> HTMLResponse:
        """Show every user and every token. ``fault``: why a change was refused, with what was ``typed`` into
        the drawer ``opened``; ``token``: the secret of the token just created, ``token_name``, which is shown
        once; ``done``: what was just done to the user ``name``."""
        return render(
            self.request,
            "users/page.html",
            status=422 if fault else 200,
            users=await self.accounts.users(),
            done=done,
            name=name,
            tokens=await self.accounts.tokens(),
            roles=PEOPLE_ROLES,
            buses=self.accounts.buses,
            fault=fault,
            encryption_fault=service_of(self.request, Encryption).fault,
            token_name=token_name,
            token=token,
            opened=opened,
            typed=defaultdict(str, typed or {}),
        )

    async def after(
        self,
        change: Awaitable[None],
        done: str,
        name: str,
        opened: str = "",
        typed: Mapping[str, str] | None = None,
    ) -> Response:
        """Carry out a change and return to the page, which says that it was ``done`` to ``name``. If the
        change is refused, explain it on the page, in the drawer ``opened`` with what was ``typed``, or in the
        dialog."""
        try:
            await change
        except CallerError as error:
            if is_fragment(self.request):
                raise
            return await self.render(fault=error, opened=opened, typed=typed)
        return send_to(self.request, "/users", done=done, name=name)


Users = Annotated[
    UsersPage, looked_up(lambda connection: UsersPage(connection, service_of(connection, Accounts)))
]


@router.get("/users")
async def users_page(_: Admin, page: Users) -> Response:
    """Show every user and every token, and what was just done to one of them."""
    result = result_of(page.request)
    shown = await page.render(done=result.get("done", ""), name=result.get("name", ""))
    return shown_once(page.request, shown)


@router.post("/users")
async def add_user(
    by: Annotated[Person, ADD_USER.permitted],
    page: Users,
    name: TypedName = "",
    role: FormText = "viewer",
    password: FormText = "",
) -> Response:
    """Add a person, who signs in by password."""
    change = page.accounts.add_user(name, role_named(role), password, by=by)
    return await page.after(change, "added", composed(name), "add-user", {"name": name, "role": role})


@router.post("/users/panels")
async def add_panel(
    by: Annotated[Person, ADD_PANEL.permitted],
    page: Users,
    panel: TypedName = "",
    panel_role: FormText = "viewer",
    pin: FormText = "",
    home: FormText = "/",
) -> Response:
    """Add a panel on the wall, which signs in by PIN; it is a viewer unless it is given another role."""
    role, begins = role_named(panel_role), home.strip() or "/"
    change = page.accounts.add_panel(panel, role, pin, begins, by=by)
    typed = {"panel": panel, "panel_role": panel_role, "home": home}
    return await page.after(change, "added", composed(panel), "add-panel", typed)


@router.post("/users/{name}/role")
async def set_role(
    by: Annotated[Person, SET_ROLE.permitted], page: Users, name: str, role: FormText = ""
) -> Response:
    """Change the role of a user."""
    return await page.after(page.accounts.set_role(name, role_named(role), by=by), "role", name)


@router.post("/users/{name}/disable")
async def disable(by: Annotated[Person, DISABLE_USER.permitted], page: Users, name: str) -> Response:
    """Disable a user; every session ends."""
    return await page.after(page.accounts.set_disabled(name, True, by=by), "disabled", name)


@router.post("/users/{name}/enable")
async def enable(by: Annotated[Person, ENABLE_USER.permitted], page: Users, name: str) -> Response:
    """Enable a user again."""
    return await page.after(page.accounts.set_disabled(name, False, by=by), "enabled", name)


@router.post("/users/{name}/password")
async def reset_password(
    by: Annotated[Person, SET_PASSWORD.permitted], page: Users, name: str, password: FormText = ""
) -> Response:
    """Set a new password, or the PIN of a panel; every session of the user ends."""
    return await page.after(page.accounts.set_password(name, password, by=by), "password", name)


@router.get("/users/{name}/remove")
async def review_removal(_: Admin, page: Users, name: str) -> HTMLResponse:
    """Show the consequences of removing a user."""
    found = next((user for user in await page.accounts.users() if user.name == name), None)
    has_company_account = found is not None and found.company_account is not None
    return render(
        page.request, "users/_review_remove.html", name=name, has_company_account=has_company_account
    )


@router.post("/users/{name}/remove")
async def remove(by: Annotated[Person, REMOVE_USER.permitted], page: Users, name: str) -> Response:
    """Remove a user, whose actions stay in the events."""
    return await page.after(page.accounts.remove_user(name, by=by), "removed", name)


@router.post("/users/tokens")
async def create_token(
    by: Annotated[Person, CREATE_TOKEN.permitted],
    page: Users,
    token: TypedName = "",
    token_role: FormText = "viewer",
    token_bus: FormText = "",
    expires: FormText = "",
) -> HTMLResponse:
    """Create a token; its secret is in this response and nowhere else."""
    create = page.accounts.create_token
    typed = {"token": token, "token_role": token_role, "token_bus": token_bus, "expires": expires}
    try:
        role, days = role_named(token_role, Role), _days(expires)
        bus = token_bus if role == Role.WORKER else ""
        secret = await create(token, role, bus=bus, expires_days=days, by=by)
    except CallerError as error:
        return await page.render(fault=error, opened="add-token", typed=typed)
    return await page.render(token_name=token, token=secret)


@router.get("/users/tokens/{name}/revoke")
async def review_revocation(_: Admin, page: Users, name: str) -> HTMLResponse:
    """Show the consequences of revoking a token, and whether a program has been using it."""
    token = next((token for token in await page.accounts.tokens() if token.name == name), None)
    used_at = token.used_at if token else None
    return render(page.request, "users/_review_revoke.html", name=name, used_at=used_at)


@router.post("/users/tokens/{name}/revoke")
async def revoke_token(by: Annotated[Person, REVOKE_TOKEN.permitted], page: Users, name: str) -> Response:
    """Revoke a token, which is refused from the next request on."""
    return await page.after(page.accounts.revoke_token(name, by=by), "revoked", name)


def _days(typed: str) -> int | None:
    """Return the typed number of days; None for an empty text. Raise CallerError."""
    text = typed.strip()
    if not text:
        return None
    if not text.isdecimal() or len(text) > 4:
        raise CallerError(Message("token_days_malformed"))
    return int(text)


api_router = APIRouter(prefix="/api/v1", tags=["who"], route_class=ApiRoute)


class CurrentUser(TypedDict):
    """The current user."""

    name: str
    role: Role
    via: Literal["session", "token", "worker", "demo"]


@api_router.get("/me")
async def get_current_user(person: Viewer) -> CurrentUser:
    """Return the current user: name and role."""
    assert person.via != "console"
    return {"name": person.name, "role": person.role, "via": person.via}
