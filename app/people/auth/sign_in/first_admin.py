"""The first admin of a site, created in the browser with a code that the server printed at its start.

Who reads the output of the server could add a user by the command line as well. The code holds until there
is a user, or the server ends.
"""

from __future__ import annotations

import hmac
import secrets
from dataclasses import dataclass, field
from math import ceil

from app.core.server.addresses import source_of
from app.errors import Problem
from app.people.audit.log import EventLog
from app.people.auth.accounts import Accounts
from app.people.auth.sign_in.signin import SignIn, count_refusal, too_soon
from app.people.auth.sign_in.throttle import Attempt, Throttle
from bus.errors import CallerError
from bus.instants import MonotonicClock, monotonic_now
from bus.messages import Message
from bus.text import composed

_LETTERS = "ABCDEFGHJKMNPQRSTVWXYZ23456789"
"""Without those that look alike."""
GROUPS, GROUP = 3, 4
"""59 bits: a guess every ten seconds finds none."""


@dataclass(eq=False, repr=False)
class FirstAdmin:
    """``code`` is empty where there is a user, and where requests need none (a demo)."""

    _accounts: Accounts
    _sign_in: SignIn
    _events: EventLog
    _monotonic: MonotonicClock = monotonic_now
    code: str = ""
    _throttle: Throttle = field(default_factory=Throttle)

    async def start(self) -> None:
        """Make the code where there is no user yet."""
        if await self._sign_in.has_no_users():
            self.code = new_code()

    async def is_open(self) -> bool:
        """Whether the first admin can be created now."""
        return bool(self.code) and await self._sign_in.has_no_users()

    async def create(self, code: str, name: str, password: str, again: str, address: str) -> None:
        """Create the admin; the code is spent then. Raises Problem 409 where there is a user, 429 after too
        many wrong codes, 401 for a wrong one, and CallerError for a name or a password that cannot be."""
        if not await self.is_open():
            raise Problem(409, "not_in_state", Message("first_admin_exists"))
        self._check(code, address)
        if composed(password) != composed(again):
            raise CallerError(Message("new_passwords_differ"))
        await self._accounts.add_first_admin(name, password, address=address)
        self.code = ""

    async def note_refusal(self, address: str) -> None:
        """Count a wrong code in the events."""
        what = Message("event_first_admin_refused")
        await count_refusal(self._events, "login_refused", what, Message("unknown_name"), address)

    def _check(self, code: str, address: str) -> None:
        """Bounded as sign-ins of one name are, from networks where no one has signed in yet."""
        attempt, now = Attempt("", source_of(address)), self._monotonic()
        wait_s = self._throttle.wait_s(attempt, now)
        if wait_s > 0:
            raise too_soon(ceil(wait_s))
        self._throttle.begin(attempt, now)
        if not hmac.compare_digest(_plain(code).encode(), _plain(self.code).encode()):
            self._throttle.failed(attempt, now)
            raise WrongCodeError(401, "unauthorized", Message("first_admin_code_wrong"))
        self._throttle.succeeded(attempt, now)


class WrongCodeError(Problem):
    """401: it is not the code of this start; the caller owes `FirstAdmin.note_refusal`."""


def new_code() -> str:
    """A code to be typed: ``K7QX-M2RT-9WBD``."""
    return "-".join("".join(secrets.choice(_LETTERS) for _ in range(GROUP)) for _ in range(GROUPS))


def _plain(code: str) -> str:
    """As typed, in capitals and without what divides its groups."""
    return "".join(code.upper().replace("-", " ").split())
