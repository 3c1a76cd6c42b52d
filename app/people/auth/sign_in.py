"""Signing in and out, how soon that may be tried again, and the first admin.

After wrong passwords a name has to wait at one place: guessing becomes slow, and no one is locked out at
another place. A place is a browser in which this name has signed in before (OWASP: device cookies), or else
the network of the address. Such a browser has its own count and waits for nothing else. A network that fails
with many names has to wait, and so has a name that many networks try, except at a network from which anyone
has signed in before. A network is treated in the same way for every name, whether a user has it or not: the
responses to a shared address do not show which names exist.

The first admin of a site is created in the browser with a code that the server printed at its start: a person
who reads the output of the server could add a user by the command line as well. The code holds until there is
a user, or the server ends.
"""

from __future__ import annotations

import hmac
import secrets
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from math import ceil
from typing import Generic, TypeVar

from app.core.database import Database, StoreConnection
from app.core.server.addresses import source_of
from app.core.server.turns import FairQueue, TooManyWaitingError
from app.core.web.access import Person
from app.core.web.routes import RateLimit
from app.errors import Problem, StoreError
from app.people.audit.entry import EventKind
from app.people.audit.log import EventLog
from app.people.auth import rules, store
from app.people.auth.accounts import LOG_OUT, Accounts
from app.people.auth.passwords import MAX_CODE_POINTS, check_secret, hash_secret, is_outdated, verify_secret
from app.people.auth.rights import Rights
from app.people.auth.settings import Sessions
from app.people.auth.store import User
from bus.errors import CallerError
from bus.instants import Clock, Monotonic, MonotonicClock, monotonic_now, unix_now
from bus.messages import Message, term
from bus.pacing import Bucket
from bus.validation import composed

K = TypeVar("K")
V = TypeVar("V")

FREE, FREE_OF_PANEL = 5, 3
"""The failures of a name at one place without any wait; a PIN has few digits."""
FIRST_WAIT_S, MAX_WAIT_S = 2.0, 300.0
FORGOTTEN_AFTER_S = 900.0
"""The seconds without a failure after which none counts any more; the longest wait is over by then."""
OF_ADDRESS, OF_ADDRESS_WINDOW_S = 30, 300.0
"""The failures of one address, which several people may share behind a proxy; browsers with their own count
do not add to them."""
OF_NAME = 10
"""The tries of one name from networks where no one ever signed in, all together, before they are slowed."""
OF_NAME_EVERY_S, OF_PANEL_EVERY_S = 10.0, 30.0
MAX_KEPT = 10_000
"""The most names, addresses and pairs that are each remembered; the longest unused are dropped first."""


@dataclass(slots=True)
class _Failures:
    """The failures of one name at one place, and the time of the last."""

    count: int = 0
    at: Monotonic = Monotonic(0.0)

    def recent(self, now: Monotonic) -> int:
        """Return the number of failures that still count."""
        return self.count if now - self.at < FORGOTTEN_AFTER_S else 0


class Bounded(Generic[K, V]):
    """A store of at most ``most`` values by key; ``new`` makes the value of a new key."""

    def __init__(self, most: int, new: Callable[[], V]) -> None:
        self._most = most
        self._new = new
        self._values: OrderedDict[K, V] = OrderedDict()

    def __len__(self) -> int:
        return len(self._values)

    def get(self, key: K) -> V:
        """Return the value of a key, for reading; use `kept` to change one."""
        found = self._values.get(key)
        return self._new() if found is None else found

    def kept(self, key: K) -> V:
        """Return the value of a key, to be changed; the key is the newest from now on."""
        found = self._values.setdefault(key, self._new())
        self._values.move_to_end(key)
        while len(self._values) > self._most:
            self._values.popitem(last=False)
        return found

    def drop(self, key: K) -> None:
        self._values.pop(key, None)


@dataclass(frozen=True, slots=True)
class Attempt:
    """An attempt to sign in. ``own_browser``: ``place`` is a browser in which the name has signed in before;
    ``used_network``: it is a network from which someone has, under any name."""

    name: str
    place: str
    panel: bool = False
    own_browser: bool = False
    used_network: bool = False

    @property
    def known(self) -> bool:
        """Whether the place is known from an earlier sign-in."""
        return self.own_browser or self.used_network

    @property
    def pair(self) -> tuple[str, str]:
        """The key of the failures that back off together."""
        return self.name, self.place


class Throttle:
    """The failures of the last quarter of an hour."""

    def __init__(self, most: int = MAX_KEPT) -> None:
        self._pairs: Bounded[tuple[str, str], _Failures] = Bounded(most, _Failures)
        self._places: Bounded[str, Bucket] = Bounded(
            most, lambda: Bucket(OF_ADDRESS / OF_ADDRESS_WINDOW_S, OF_ADDRESS)
        )
        self._names: Bounded[str, Bucket] = Bounded(most, lambda: Bucket(1 / OF_NAME_EVERY_S, OF_NAME))
        self._panels: Bounded[str, Bucket] = Bounded(most, lambda: Bucket(1 / OF_PANEL_EVERY_S, OF_NAME))

    def wait_s(self, attempt: Attempt, now: Monotonic) -> float:
        """Return the seconds that an attempt must wait; 0.0 if it may begin now."""
        waits = [self._wait_of_pair(attempt, now)]
        if not attempt.own_browser:
            waits.append(self._places.get(attempt.place).wait_s(now))
        if not attempt.known:
            waits.append(self._names_of(attempt).get(attempt.name).wait_s(now))
        return max(waits)

    def begin(self, attempt: Attempt, now: Monotonic) -> None:
        """Count an attempt before its result is known, because otherwise each of many at once would be
        allowed."""
        if not attempt.known:
            self._names_of(attempt).kept(attempt.name).pour(1, now)

    def failed(self, attempt: Attempt, now: Monotonic) -> None:
        """Count a wrong password or PIN."""
        failures = self._pairs.kept(attempt.pair)
        failures.count, failures.at = failures.recent(now) + 1, now
        if not attempt.own_browser:
            self._places.kept(attempt.place).pour(1, now)

    def succeeded(self, attempt: Attempt, now: Monotonic) -> None:
        """Count a right secret, which clears the failures of the name's own browser. Those of its network
        stay: other people share it, and would learn that there is such a user."""
        if attempt.own_browser:
            self._pairs.drop(attempt.pair)
        if not attempt.known:
            self._names_of(attempt).kept(attempt.name).pour(-1, now)

    def _names_of(self, attempt: Attempt) -> Bounded[str, Bucket]:
        return self._panels if attempt.panel else self._names

    def _wait_of_pair(self, attempt: Attempt, now: Monotonic) -> float:
        failures = self._pairs.get(attempt.pair)
        over = failures.recent(now) - (FREE_OF_PANEL if attempt.panel else FREE)
        if over < 0:
            return 0.0
        wait: float = min(FIRST_WAIT_S * 2.0 ** min(over, 16), MAX_WAIT_S)
        return max(0.0, failures.at + wait - now)


_WRONG = {False: Message("name_or_password_wrong"), True: Message("name_or_pin_wrong")}
"""The error for a person, and for a panel."""
MAX_HASHED_AT_ONCE = 2
"""The most secrets hashed at once. Each takes 20 ms of a core."""
MAX_WAITING_OF_PLACE = 5
MAX_WAITING = 200
"""The most that wait, for two seconds of hashing; at most half for places without an earlier sign-in."""


class WrongSecretError(Problem):
    """The refusal, 401, of an unknown user or a wrong secret."""


@dataclass(frozen=True, slots=True)
class SignedIn:
    """A session that has begun: its cookie, that of its browser, and its user."""

    session: str
    device: str
    user: User


@dataclass(eq=False, repr=False)
class SignIn:
    """The sessions of people and panels, from their beginning to their end."""

    _database: Database
    _events: EventLog
    sessions: Sessions
    _rights: Rights
    _clock: Clock = unix_now
    _monotonic: MonotonicClock = monotonic_now
    site: str = ""
    _throttle: Throttle = field(default_factory=Throttle)
    _has_users: bool = False
    """Whether there are users. Once true it stays so: the last admin with a password cannot be removed."""
    _hashing: FairQueue[str] = field(
        default_factory=lambda: FairQueue(MAX_HASHED_AT_ONCE, 1, MAX_WAITING_OF_PLACE, MAX_WAITING)
    )

    async def sign_in(
        self, name: str, secret: str, address: str, *, panel: bool = False, device: str = ""
    ) -> SignedIn:
        """Begin a session. ``device``: the cookie of a browser that has signed in before. Raise
        WrongSecretError, after which `note_refusal` is to be called; Problem 429 with the time to wait after
        too many, 403 for a panel that has more rights than a panel may have."""
        user = await self.identify(name, secret, address, panel=panel, device=device)
        if user.is_refused_panel:
            refusal = Message.of("panel_with_higher_role", called=user.name, role=term(user.role))
            raise Problem(403, "forbidden", refusal)
        weak = self._is_weak(user, secret)
        return await self.begin(user, address, device, Message("event_signed_in"), weak_secret=weak)

    async def identify(
        self, name: str, secret: str, address: str, *, panel: bool = False, device: str = ""
    ) -> User:
        """Return the user whose password or PIN it is, who signs in, or signs at the page of another user.
        Raise WrongSecretError, after which `note_refusal` is to be called; Problem 429 after too many."""
        if not name or not secret:
            # No user has an empty name or secret: it is not checked, costs nothing, and is no event.
            raise Problem(401, "unauthorized", _WRONG[panel])
        user = await self._checked(name, secret, address, device, panel)
        if user is None:
            raise WrongSecretError(401, "unauthorized", _WRONG[panel])
        return user

    async def has_company_account(self, name: str) -> bool:
        """Return whether the user of this name signs in by a company account."""
        found = await self._database.read(lambda connection: store.user(connection, name))
        return found is not None and found[0].company_account is not None

    async def check_present(self, name: str, secret: str, address: str, device: str = "") -> None:
        """Check the present password before it is changed, with the limits of a sign-in. Raise CallerError
        for a wrong one, Problem 429 after too many."""
        if await self._checked(name, secret, address, device, panel=False) is None:
            await count_refusal(self._events, "user", Message("event_password_change_refused"), name, address)
            raise CallerError(Message("present_password_wrong"))

    async def sign_out(self, cookie: str, person: Person) -> None:
        """End the session of a cookie, which belongs to this person. Raise Problem 403."""
        LOG_OUT.check(person)
        await self.end(rules.secret_hash(cookie))
        performed = LOG_OUT.by(person)
        performed["origin"] = person.address
        await self._events.record(**performed)

    async def has_no_users(self) -> bool:
        """Return whether no one can sign in without a provider of company accounts."""
        if not self._has_users:
            self._has_users = await self._database.read(store.has_own_users)
        return not self._has_users

    async def end(self, hash_: bytes) -> None:
        """End the session with this hash."""
        await self._database.write(lambda connection: store.end_session(connection, hash_))
        await self._rights.apply()

    def lifetime_of(self, user: User) -> rules.Lifetime:
        """Return how long the sessions of this user last."""
        return rules.lifetime(self.sessions, panel=user.panel)

    async def _checked(self, name: str, secret: str, address: str, device: str, panel: bool) -> User | None:
        """Return the user whose secret it is, within the limits; None for a wrong one. Raise Problem 429."""
        attempt = await self._attempt(name, address, device, panel)
        self._refuse_too_soon(attempt)
        try:
            async with self._hashing.turn(attempt.place, known=attempt.known):
                self._refuse_too_soon(attempt)
                self._throttle.begin(attempt, self._monotonic())
                user = await self._verified(name, secret, panel)
                if user is None:
                    self._throttle.failed(attempt, self._monotonic())
                else:
                    self._throttle.succeeded(attempt, self._monotonic())
                return user
        except TooManyWaitingError:
            raise _too_soon(1) from None

    async def _attempt(self, name: str, address: str, device: str, panel: bool) -> Attempt:
        network, browser = source_of(address), _browser(device)
        is_own, is_used = await self._database.read(
            lambda connection: store.are_places(connection, name, browser, network)
        )
        if device and is_own:
            return Attempt(name, browser, panel, own_browser=True)
        return Attempt(name, network, panel, used_network=is_used)

    def _refuse_too_soon(self, attempt: Attempt) -> None:
        wait_s = self._throttle.wait_s(attempt, self._monotonic())
        if wait_s > 0:
            raise _too_soon(ceil(wait_s))

    async def _verified(self, name: str, secret: str, panel: bool) -> User | None:
        secret = secret[: MAX_CODE_POINTS + 1]
        user, stored = await self._user_or_decoy(name)
        if not await verify_secret(stored, secret):
            return None
        if user is None or user.panel is not panel or user.disabled:
            return None
        if is_outdated(stored):
            hashed = await hash_secret(secret)
            await self._database.write(lambda c: store.replace_hash(c, name, stored, hashed))
        return user

    async def _user_or_decoy(self, name: str) -> tuple[User | None, str]:
        """Return a user with the hash of the secret. For an unknown name, and for a user without a password,
        the hash is that of another user, always the same one: hashes of an earlier version take longer, and
        the time must not reveal which names exist."""
        number = int(self._events.keys.ring.seal("decoy", name), 16)

        def find(connection: StoreConnection) -> tuple[User | None, str]:
            hashes = store.secret_hashes(connection)
            decoy = hashes[number % len(hashes)] if hashes else ""
            found = store.user(connection, name)
            has_password = found is not None and found[0].company_account is None
            return found if found is not None and has_password else (None, decoy)

        return await self._database.read(find)

    async def begin(
        self, user: User, address: str, device: str, what: Message, *, weak_secret: bool = False
    ) -> SignedIn:
        """Begin a session of a user who was verified. ``what``: the text of its event."""
        session, device, now = rules.new_secret(), device or rules.new_secret(), self._clock()
        hash_, ends = rules.secret_hash(session), self.lifetime_of(user).ends_at(now, now)
        places = (source_of(address), _browser(device))

        def begin(connection: StoreConnection) -> None:
            store.begin_session(connection, hash_, user.name, now, ends, weak_secret=weak_secret)
            store.note_places(connection, user.name, places, now)

        await self._database.write(begin)
        await self._rights.refresh()
        await self._events.record(kind="login", what=what, who=user.name, origin=address)
        return SignedIn(session, device, user)

    def _is_weak(self, user: User, secret: str) -> bool:
        """Return whether today's rules refuse the secret. It works until it is changed, and the admin sees
        that."""
        try:
            check_secret(secret, user=user.name, panel=user.panel, site=self.site)
        except CallerError:
            return True
        return False

    async def note_refusal(self, name: str, address: str) -> None:
        """Count a wrong secret in the events. It is written to the disk for some names and not for others, so
        only once the refusal is sent: its time must not reveal which names exist."""
        known = await self._database.read(lambda connection: store.user(connection, name))
        # A password typed into the field for the name must not end up in the log.
        who = name if known else Message("unknown_name")
        await count_refusal(self._events, "login_refused", Message("event_sign_in_refused"), who, address)


async def count_refusal(
    events: EventLog, kind: EventKind, what: Message, who: str | Message, address: str, message: str = ""
) -> None:
    """Count a refusal in the events; for an IPv6 address by its subnet, because a sender has as many of its
    addresses as it likes. Without its event a refusal still holds: the disk may be full."""
    with suppress(StoreError):
        await events.repeated.count(kind, what, who=who, origin=source_of(address), message=message)


def _browser(device: str) -> str:
    return f"browser {rules.secret_hash(device).hex()}"


def _too_soon(seconds: int) -> Problem:
    """Return 429 with the time to wait, after which there is one try. A refusal of a wrong secret does not
    show how many tries are left: only a guesser needs that."""
    problem = Problem(429, "too_many", Message.of("too_many_sign_ins", seconds=seconds))
    problem.headers.update(RateLimit(1, 0, seconds).headers)
    return problem.with_headers(Retry_After=str(seconds))


_LETTERS = "ABCDEFGHJKMNPQRSTVWXYZ23456789"
"""Letters and digits of which no two look alike."""
GROUPS, GROUP = 3, 4
"""The groups of a code and their length: 59 bits, of which a guess every ten seconds finds none."""


@dataclass(eq=False, repr=False)
class FirstAdmin:
    """The creation of the first admin. ``code`` is empty once there is a user, and in a demo, whose requests
    need none."""

    _accounts: Accounts
    _sign_in: SignIn
    _events: EventLog
    _monotonic: MonotonicClock = monotonic_now
    code: str = ""
    _throttle: Throttle = field(default_factory=Throttle)

    async def start(self) -> None:
        """Make the code if there is no user yet."""
        if await self._sign_in.has_no_users():
            self.code = new_code()

    async def is_open(self) -> bool:
        """Return whether the first admin can be created now."""
        return bool(self.code) and await self._sign_in.has_no_users()

    async def create(self, code: str, name: str, password: str, again: str, address: str) -> None:
        """Create the admin, after which the code is spent. Raise Problem 409 if there is a user, 429 after
        too many wrong codes, 401 for a wrong one, and CallerError for a name or a password that is
        refused."""
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
        """Check the code, with the limits of sign-ins of one name from networks where no one has signed in
        yet. Raise Problem 401 and 429."""
        attempt, now = Attempt("", source_of(address)), self._monotonic()
        wait_s = self._throttle.wait_s(attempt, now)
        if wait_s > 0:
            raise _too_soon(ceil(wait_s))
        self._throttle.begin(attempt, now)
        if not hmac.compare_digest(_plain(code).encode(), _plain(self.code).encode()):
            self._throttle.failed(attempt, now)
            raise WrongCodeError(401, "unauthorized", Message("first_admin_code_wrong"))
        self._throttle.succeeded(attempt, now)


class WrongCodeError(Problem):
    """The refusal, 401, of a wrong code; `FirstAdmin.note_refusal` is to be called after it."""


def new_code() -> str:
    """Return a new code that is easy to type: ``K7QX-M2RT-9WBD``."""
    return "-".join("".join(secrets.choice(_LETTERS) for _ in range(GROUP)) for _ in range(GROUPS))


def _plain(code: str) -> str:
    """Return a code in capitals, without the separators of its groups."""
    return "".join(code.upper().replace("-", " ").split())
