"""Limits how many connections are open: for each address, for each account, and in all.

New clients are not turned away. Beyond a limit the oldest of the group with the most is dropped, one that
waits for its client before one that is being served: connections that are held open displace one another, and
no others. Signed-in users, the bus workers among them, are counted by account, apart from strangers.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection
from dataclasses import dataclass
from typing import Protocol

from app.core.server.admission.addresses import Network, is_within, source_of

MAX_OF_ADDRESS = 512
"""Connections of strangers at one address; all browsers of a plant may share an address until they have sent
their cookie, and return at once after a restart."""
MAX_STRANGERS = 1024
MAX_OF_ACCOUNT = 600
MAX_IN_ALL = 2000


class ConnectionHolder(Protocol):
    """The protocol that serves a connection."""

    def give_way(self) -> None:
        """End the connection now."""

    def is_idle(self) -> bool:
        """Whether the client keeps the server waiting."""


@dataclass(eq=False, slots=True)
class Connection:
    """One open connection. ``address``: the other end's, which is a trusted proxy's behind one."""

    address: str
    holder: ConnectionHolder | None
    """None once it has ended: the protocol refers to it, and neither would go before the next collection."""
    account: str = ""
    """The account that it has shown a valid credential of; empty: a stranger."""

    def drop(self) -> None:
        if self.holder is not None:
            self.holder.give_way()

    def is_idle(self) -> bool:
        """Whether the client keeps the server waiting."""
        return self.holder is not None and self.holder.is_idle()


class Connections:
    """The connections that are open now; ``most``: how many the system allows."""

    def __init__(self, trusted_proxies: Collection[Network] = (), most: int = MAX_IN_ALL) -> None:
        self._trusted = trusted_proxies
        self._most = min(most, MAX_IN_ALL)
        self._strangers: defaultdict[str, dict[Connection, None]] = defaultdict(dict)
        self._known: defaultdict[str, dict[Connection, None]] = defaultdict(dict)
        self._count = {True: 0, False: 0}

    def open(self, connection: Connection) -> None:
        """Count one more connection. A trusted proxy counts as one account: it has its own limits for its
        clients."""
        if is_within(connection.address, self._trusted):
            connection.account = f"proxy {connection.address}"
        self._add(connection)

    def identify(self, connection: Connection, account: str) -> None:
        """Count a connection for the account that it has shown a valid credential of."""
        if connection.account or connection not in self._strangers.get(self._key(connection), ()):
            return
        self.close(connection)
        connection.account = account
        self._add(connection)

    def close(self, connection: Connection) -> None:
        """Stop counting a connection, unless it was dropped before."""
        groups, key = self._groups(connection), self._key(connection)
        if connection in groups.get(key, ()):
            del groups[key][connection]
            self._count[bool(connection.account)] -= 1
            if not groups[key]:
                del groups[key]

    def _add(self, connection: Connection) -> None:
        groups, is_known = self._groups(connection), bool(connection.account)
        group = groups[self._key(connection)]
        group[connection] = None
        self._count[is_known] += 1
        if len(group) > (MAX_OF_ACCOUNT if is_known else MAX_OF_ADDRESS):
            self._drop_one(group)
        elif not is_known and self._count[False] > MAX_STRANGERS:
            self._drop_one(max(self._strangers.values(), key=len))
        elif sum(self._count.values()) > self._most:
            self._drop_one(max((*self._strangers.values(), *self._known.values()), key=len))

    def _drop_one(self, group: dict[Connection, None]) -> None:
        oldest = next(iter(group))
        dropped = next((connection for connection in group if connection.is_idle()), oldest)
        self.close(dropped)
        dropped.drop()

    def _groups(self, connection: Connection) -> defaultdict[str, dict[Connection, None]]:
        return self._known if connection.account else self._strangers

    def _key(self, connection: Connection) -> str:
        return connection.account or source_of(connection.address)
