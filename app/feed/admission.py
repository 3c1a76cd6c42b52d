"""Whether a worker that says hello is admitted. Pure."""

from __future__ import annotations

from collections.abc import Collection

from app.feed.holders import Credential
from bus.contract import CONTRACT_VERSION, Hello


def refusal(hello: Hello, credential: Credential, buses: Collection[str]) -> str:
    """Why no bus is for this worker, in words for its operator; empty where there is one. ``buses``: those of
    the configuration."""
    if hello.version != CONTRACT_VERSION:
        return (
            f"this dashboard speaks version {CONTRACT_VERSION} of the link and the worker {hello.version}: "
            "install the same release of lineside on both"
        )
    if hello.bus != credential.bus:
        return f"the token is for bus {credential.bus}; create one for the bus of this worker"
    if hello.bus not in buses:
        known = ", ".join(buses) or "none"
        return f"no [[bus]] is called {hello.bus} in this dashboard's lineside.toml (it has: {known})"
    return ""
