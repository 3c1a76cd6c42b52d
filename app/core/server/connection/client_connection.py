"""The connection of a client as the app knows it, beside ``receive`` and ``send``."""

from __future__ import annotations

from typing import Protocol, cast

from starlette.types import Scope

CONNECTION = "lineside.connection"
"""Its key in the ``state`` of an ASGI scope."""


class ClientConnection(Protocol):
    """One connection of a client."""

    def identify(self, account: str) -> None:
        """Count it for this account from now on: it has shown a valid credential."""

    def is_certified(self) -> bool:
        """Whether it has shown a certificate of an authority that the server requests one of."""

    def trust(self) -> None:
        """Take large messages on a WebSocket from now on."""


class NoClientConnection:
    """Takes the place of a connection where the server offers none."""

    def identify(self, account: str) -> None: ...

    def is_certified(self) -> bool:
        return False

    def trust(self) -> None: ...


def client_connection(scope: Scope) -> ClientConnection:
    """Return the connection that the server put into the scope of a request or a WebSocket."""
    offered = scope.get("state", {}).get(CONNECTION)
    return NoClientConnection() if offered is None else cast(ClientConnection, offered)
