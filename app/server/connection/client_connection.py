"""What the server offers the app of a connection, beside ``receive`` and ``send``: an ASGI extension."""

from __future__ import annotations

from typing import Protocol, cast

from starlette.types import Scope

EXTENSION = "lineside.connection"


class ClientConnection(Protocol):
    """One connection of a client."""

    def identify(self, account: str) -> None:
        """Count it for this account from now on: it has shown a valid credential."""

    def is_certified(self) -> bool:
        """Whether it has shown a certificate of an authority that the server requests one of."""

    def trust(self) -> None:
        """Take large messages on a WebSocket from now on, and as many as the app reads."""

    def write(self, frame: bytes, /) -> bool:
        """Write a complete frame in this turn of the loop, if a WebSocket is open and everything before has
        left; otherwise do nothing and return False. Raises nothing. ``send`` may be used too, one after the
        other."""


class NoClientConnection:
    """Where the server offers none: everything goes by ``send``, which is slower and has the same effect."""

    def identify(self, account: str) -> None: ...

    def is_certified(self) -> bool:
        return False

    def trust(self) -> None: ...

    def write(self, _frame: bytes, /) -> bool:
        return False


def client_connection(scope: Scope) -> ClientConnection:
    """What the server put into the scope of a request or a WebSocket."""
    offered = scope.get("extensions", {}).get(EXTENSION)
    return NoClientConnection() if offered is None else cast(ClientConnection, offered)
