"""WebSockets take small messages, and few, until the app trusts their sender."""

from __future__ import annotations

from collections.abc import Callable

from starlette.types import Scope

EXTENSION = "lineside.trust"


def trust_sender(scope: Scope) -> None:
    """Take large messages on this WebSocket from now on, where the server limits them."""
    offered: Callable[[], None] | None = scope.get("extensions", {}).get(EXTENSION)
    if offered is not None:
        offered()
