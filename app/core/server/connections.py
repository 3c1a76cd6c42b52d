"""The connections of clients: what the app knows of one, and the limits of all.

New clients are not turned away. Beyond a limit the oldest connection of the group with the most is dropped,
one that keeps the server waiting before one that is being served: connections that are held open displace one
another and no others. Signed-in users, the bus workers among them, are counted by account, apart from
strangers. Rules of time are pure: times are seconds on any steady clock.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection
from dataclasses import dataclass
from enum import Enum, auto

from starlette.types import Scope

from app.core.server.addresses import Network, is_within, source_of
from bus.instants import Monotonic
from bus.pacing import Bucket

CONNECTION = "lineside.connection"
"""The key of the connection in the ``state`` of an ASGI scope."""
ARRIVED_AT = "lineside.arrived_at"
"""The key in that ``state`` for the earliest time at which the first byte of the request can have arrived, by
:func:`time.monotonic`."""
BEGUN_AT = "lineside.begun_at"
"""The key in that ``state`` for the time at which the app got the request, before its body is read."""

MAX_OF_ADDRESS = 512
"""Connections of strangers at one address; all browsers of a plant may share an address until they have sent
their cookie, and return at once after a restart."""
MAX_STRANGERS = 1024
MAX_OF_ACCOUNT = 600
MAX_IN_ALL = 2000

HANDSHAKES_A_SECOND, MAX_HANDSHAKES_AT_ONCE = 20.0, 300
"""The WebSockets that one account may open in a second and at once: all pages of a plant may share one
account and return at the same time after a restart."""
HANDSHAKES_TOGETHER_A_SECOND, MAX_HANDSHAKES_TOGETHER = 60.0, 10
"""The WebSockets that each account may open in a short burst: opening one takes the event loop
milliseconds."""

MIN_RATE = 1000.0
"""The least bytes a second of a body that arrives and of a response; a modem makes three times that."""
STALL_S = 20.0
"""The seconds over which the rate of a reader is measured."""
MAX_BODY_S = 300.0
PROMPT_S = 0.25
"""The seconds within which a client that has just connected sends its request."""


class ClientConnection:
    """A connection of a client. This base class stands for one of which the server knows nothing."""

    address = ""
    """The other end of the connection; the proxy's if it comes through one."""
    account = ""
    """The account for which the client has shown a valid credential; empty for a stranger."""

    def identify(self, account: str) -> None:
        """Count the connection for this account from now on."""

    def is_certified(self) -> bool:
        """Return whether the client has shown a certificate that was verified."""
        return False

    def trust(self) -> None:
        """Accept large messages on this WebSocket from now on."""

    def give_way(self) -> None:
        """End the connection at once, to make room for another."""

    def is_idle(self) -> bool:
        """Return whether the client keeps the server waiting."""
        return True


def client_connection(scope: Scope) -> ClientConnection:
    """Return the connection that the server put into the scope of a request or a WebSocket."""
    connection: ClientConnection = scope.get("state", {}).get(CONNECTION) or ClientConnection()
    return connection


class Connections:
    """The connections that are open now; ``most``: the number that the system allows."""

    def __init__(self, trusted_proxies: Collection[Network] = (), most: int = MAX_IN_ALL) -> None:
        self._trusted = trusted_proxies
        self._most = min(most, MAX_IN_ALL)
        self._strangers: defaultdict[str, dict[ClientConnection, None]] = defaultdict(dict)
        self._known: defaultdict[str, dict[ClientConnection, None]] = defaultdict(dict)

    def open(self, connection: ClientConnection) -> None:
        """Count one more connection. A trusted proxy counts as one account: it has its own limits for its
        clients."""
        if is_within(connection.address, self._trusted):
            connection.account = f"proxy {connection.address}"
        self._add(connection)

    def identify(self, connection: ClientConnection, account: str) -> None:
        """Count a stranger's connection for the account whose valid credential it has shown."""
        if connection.account or connection not in self._strangers.get(source_of(connection.address), ()):
            return
        self.close(connection)
        connection.account = account
        self._add(connection)

    def close(self, connection: ClientConnection) -> None:
        """Stop counting a connection, unless it was dropped before."""
        groups, key = self._group_of(connection)
        if connection in groups.get(key, ()):
            del groups[key][connection]
            if not groups[key]:
                del groups[key]

    def count(self, *, known: bool) -> int:
        """Return the number of open connections of accounts, or of strangers."""
        return sum(map(len, (self._known if known else self._strangers).values()))

    def _add(self, connection: ClientConnection) -> None:
        groups, key = self._group_of(connection)
        groups[key][connection] = None
        is_known, strangers = bool(connection.account), self.count(known=False)
        if len(groups[key]) > (MAX_OF_ACCOUNT if is_known else MAX_OF_ADDRESS):
            self._drop_one(groups[key])
        elif not is_known and strangers > MAX_STRANGERS:
            self._drop_one(max(self._strangers.values(), key=len))
        elif strangers + self.count(known=True) > self._most:
            self._drop_one(max((*self._strangers.values(), *self._known.values()), key=len))

    def _drop_one(self, group: dict[ClientConnection, None]) -> None:
        oldest = next(iter(group))
        dropped = next((connection for connection in group if connection.is_idle()), oldest)
        self.close(dropped)
        dropped.give_way()

    def _group_of(
        self, connection: ClientConnection
    ) -> tuple[defaultdict[str, dict[ClientConnection, None]], str]:
        if connection.account:
            return self._known, connection.account
        return self._strangers, source_of(connection.address)


class Handshakes:
    """A limit that delays the handshakes of an account beyond their rate, because refused clients retry at
    once."""

    def __init__(self) -> None:
        self._buckets: dict[str, tuple[Bucket, Bucket]] = {}

    def wait_s(self, account: str, now: Monotonic) -> float:
        """Return the seconds that one more handshake of ``account`` has to wait."""
        fresh = (
            Bucket(HANDSHAKES_A_SECOND, MAX_HANDSHAKES_AT_ONCE),
            Bucket(HANDSHAKES_TOGETHER_A_SECOND, MAX_HANDSHAKES_TOGETHER),
        )
        return max(bucket.pour(1, now) for bucket in self._buckets.setdefault(account, fresh))


class Awaited(Enum):
    """The part of an HTTP exchange that the server awaits from the client."""

    FIRST = auto()
    """The first request; a browser may open a connection ahead of it."""
    HEAD = auto()
    """The rest of the headers of a request that has begun."""
    BODY = auto()
    NOTHING = auto()
    """Nothing is awaited: the server has to act."""
    NEXT = auto()
    """The next request, or the end of the connection."""


WITHIN_S = {Awaited.FIRST: 20.0, Awaited.HEAD: 20.0, Awaited.BODY: 20.0, Awaited.NEXT: 5.0}
"""The seconds that each may take; for a body, how long it may fall behind the least rate."""


@dataclass(slots=True)
class Pace:
    """The part that is awaited, since when, and how many of its bytes have arrived."""

    since: float
    awaited: Awaited = Awaited.FIRST
    received: int = 0

    def expect(self, awaited: Awaited, now: float) -> None:
        """Begin to await another part of the exchange."""
        self.awaited, self.since, self.received = awaited, now, 0

    def is_idle(self, now: float) -> bool:
        """Return whether the client keeps the server waiting."""
        return self.awaited is not Awaited.NOTHING and now - self.since > PROMPT_S

    def is_overdue(self, now: float) -> bool:
        """Return whether the client has taken too long."""
        if self.awaited is Awaited.NOTHING:
            return False
        earned_s = self.received / MIN_RATE if self.awaited is Awaited.BODY else 0.0
        return now - self.since > min(WITHIN_S[self.awaited] + earned_s, MAX_BODY_S)


@dataclass(slots=True)
class Backlog:
    """The bytes that were written and wait for the client to read them."""

    size: int = 0
    since: float = 0.0

    def is_stuck(self, size: int, now: float) -> bool:
        """Return whether too little was read since the window began. ``size``: bytes that wait now, to which
        nothing was added since the last call; or 0."""
        if not size or not self.size:
            self.size, self.since = size, now
            return False
        if now - self.since < STALL_S:
            return False
        was_read = self.size - size
        self.size, self.since = size, now
        return was_read < MIN_RATE * STALL_S
