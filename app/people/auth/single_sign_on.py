"""Signing in by a company account, by OpenID Connect Core 1.0, the authorization code with PKCE: to the
provider, and back with a code.

The server keeps nothing of an unfinished login: its `LoginAttempt` is in the browser.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import structlog

from app.core.server.addresses import source_of
from app.core.server.turns import FairQueue, TooManyWaitingError
from app.core.web.access import PEOPLE_ROLES, Role
from app.people.audit.log import EventLog
from app.people.auth import rules
from app.people.auth.accounts import Accounts
from app.people.auth.login_attempt import COUNTED, LoginAttempt, NotAdmittedError, new_attempt, printable
from app.people.auth.settings import OidcSettings
from app.people.auth.sign_in import MAX_KEPT, Bounded, SignedIn, SignIn, count_refusal
from app.people.auth.store import CompanyAccount, User
from bus.errors import CallerError, LinesideError
from bus.instants import MonotonicClock, monotonic_now
from bus.messages import Message
from bus.pacing import Bucket
from bus.validation import composed

if TYPE_CHECKING:
    from app.people.auth.provider import Provider

MAX_AT_ONCE = 4
MAX_WAITING_OF_PLACE, MAX_WAITING = 5, 100
ALL_S = 10.0
"""The seconds that a browser back from the provider waits, for its turn and for the provider."""
FAILURES, FAILURES_PER_S = 10, 0.2
"""The failures of one address, at once and per second. Only a browser that invents codes exceeds them."""
MAX_CODE = 4096
MAX_GROUPS = 5000

_log = structlog.get_logger()


def require_package() -> None:
    """Raise LinesideError if the package that speaks OpenID Connect is not installed."""
    if find_spec("authlib") is None:
        raise LinesideError(Message("oidc_lacks_package"))


def provider_of(settings: OidcSettings) -> Provider:
    """Return the provider of these settings. Its modules are loaded only if there is one."""
    from app.people.auth.provider import Provider

    return Provider(settings)


@dataclass(eq=False, repr=False)
class SingleSignOn:
    """The sign-ins by company accounts. ``settings``: None if no provider is configured."""

    settings: OidcSettings | None
    _accounts: Accounts
    _sign_in: SignIn
    _events: EventLog
    _monotonic: MonotonicClock = monotonic_now
    provider: Provider | None = None
    _turns: FairQueue[str] = field(
        default_factory=lambda: FairQueue(MAX_AT_ONCE, 1, MAX_WAITING_OF_PLACE, 2 * MAX_WAITING)
    )
    _failures: Bounded[str, Bucket] = field(
        default_factory=lambda: Bounded(MAX_KEPT, lambda: Bucket(FAILURES_PER_S, FAILURES))
    )

    @property
    def fault(self) -> Message | None:
        """Why no one can sign in by a company account now; None if it is possible."""
        return None if self.provider is None else self.provider.fault

    async def start(self) -> None:
        """Load the package that speaks OpenID Connect, in another thread. Raise LinesideError if it is
        missing."""
        if self.settings is not None:
            require_package()
            await asyncio.to_thread(import_module, "app.people.auth.provider")
            self.provider = provider_of(self.settings)

    async def watch(self) -> None:
        """Keep the provider's metadata and keys up to date until canceled."""
        assert self.provider is not None
        await self.provider.watch()

    async def end(self) -> None:
        """Close the connections to the provider."""
        if self.provider is not None:
            await self.provider.close()

    def begin(self, next_page: str, callback: str, *, reauthenticate: bool) -> tuple[str, LoginAttempt]:
        """Return where the browser goes, and the attempt that it keeps. ``callback``: where the provider
        sends it back to. Raise NotAdmittedError."""
        attempt = new_attempt(next_page)
        url = None
        if self.provider is not None and self.provider.fault is None:
            url = self.provider.login_url(attempt, callback, reauthenticate=reauthenticate)
        if url is None:
            raise NotAdmittedError("away")
        return url, attempt

    async def finish(
        self,
        attempt: LoginAttempt | None,
        response: dict[str, str],
        callback: str,
        *,
        address: str,
        device: str,
    ) -> SignedIn:
        """Begin the session of a browser that the provider sends back. ``response``: the parameters that it
        brings. Raise NotAdmittedError, whose reason is logged and counted."""
        try:
            code = self._code(attempt, response)
            assert attempt is not None
            user = await self._user(attempt, code, callback, address)
        except NotAdmittedError as refused:
            await self._note(refused, address)
            raise
        what = Message("event_signed_in_by_company_account")
        return await self._sign_in.begin(user, address, device, what)

    def _code(self, attempt: LoginAttempt | None, response: dict[str, str]) -> str:
        """Return the code of a response to this attempt. Raise NotAdmittedError."""
        if self.provider is None or attempt is None or not attempt.has_state(response.get("state", "")):
            raise NotAdmittedError("expired")
        if not self.provider.is_issuer(response.get("iss")):
            raise NotAdmittedError("token", "the response is of another issuer")
        error = response.get("error")
        if error is not None:
            raise NotAdmittedError("canceled" if error == "access_denied" else "provider", printable(error))
        code = response.get("code", "")
        if not 0 < len(code) <= MAX_CODE:
            raise NotAdmittedError("provider", "no code")
        return code

    async def _user(self, attempt: LoginAttempt, code: str, callback: str, address: str) -> User:
        assert self.provider is not None
        assert self.settings is not None
        place = source_of(address)
        if not self._failures.get(place).has_room(self._monotonic()):
            raise NotAdmittedError("busy", "too many failures of this address")
        try:
            async with asyncio.timeout(ALL_S), self._turns.turn(place, known=False):
                claims = await self.provider.claims(code, attempt, callback)
        except TooManyWaitingError:
            raise NotAdmittedError("busy", "too many are waiting") from None
        except TimeoutError:
            raise NotAdmittedError("away", "it took too long") from None
        except NotAdmittedError as refused:
            if refused.reason != "away":
                self._failures.kept(place).pour(1, self._monotonic())
            raise
        account = CompanyAccount(self.settings.issuer, claims["sub"])
        name, role = name_of(claims, self.settings), _role_of(claims, self.settings)
        if role is None:
            raise NotAdmittedError("groups", "no group has a role", name)
        try:
            user = await self._accounts.follow_provider(account, name, role, address=address)
        except CallerError as error:
            raise NotAdmittedError("name_taken" if name else "name", str(error), name) from None
        if user.disabled:
            raise NotAdmittedError("disabled", "the user is disabled", user.name)
        return user

    async def _note(self, refused: NotAdmittedError, address: str) -> None:
        _log.info("company account not admitted", reason=refused.reason, detail=refused.detail)
        if refused.reason in COUNTED:
            who = refused.name or Message("unknown_name")
            what = Message("event_company_account_refused")
            await count_refusal(self._events, "login_refused", what, who, address, refused.detail)


def name_of(claims: Mapping[str, Any], settings: OidcSettings) -> str:
    """Return the name for a new user with these claims; empty if no user may have it."""
    name = claims.get(settings.name_claim)
    if not isinstance(name, str):
        return ""
    with suppress(CallerError):
        rules.check_name(name := composed(name[: 4 * rules.MAX_NAME + 1]))
        return name
    return ""


def _role_of(claims: Mapping[str, Any], settings: OidcSettings) -> Role | None:
    """Return the highest role of the groups; None if no group has one."""
    found = claims.get(settings.groups_claim)
    groups = [found] if isinstance(found, str) else found if isinstance(found, list) else []
    roles = {
        Role(settings.roles[each])
        for each in groups[:MAX_GROUPS]
        if isinstance(each, str) and each in settings.roles
    }
    return max(roles, key=PEOPLE_ROLES.index, default=None)
