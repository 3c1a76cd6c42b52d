"""Whether a worker that says hello is admitted. Pure."""

from __future__ import annotations

from collections.abc import Collection

from app.feed.holders import Credential, Holder
from bus.contract import CONTRACT_VERSION, Hello

HELD = "another worker has this bus, or had it a moment ago"


def refusal(
    hello: Hello,
    credential: Credential,
    buses: Collection[str],
    holder: Holder | None,
    now: float,
) -> str:
    """Why a worker is refused, in words for whoever runs it; empty where it is admitted. ``buses``: those of
    the configuration; ``holder``: of the bus that it says hello for; ``now``: monotonic."""
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
    if holder is not None and not holder.yields_to(hello.worker, credential, now):
        return HELD
    return ""
