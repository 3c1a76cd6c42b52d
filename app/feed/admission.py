"""Whether a worker is admitted after its hello. Pure."""

from __future__ import annotations

from collections.abc import Collection

from app.feed.holders import Credential
from bus.contract import CONTRACT_VERSION, Hello
from bus.messages import Message


def refusal(hello: Hello, credential: Credential, buses: Collection[str]) -> Message | None:
    """Why no bus is for this worker; None where there is one. ``buses``: those of the configuration."""
    if hello.version != CONTRACT_VERSION:
        return Message.of("worker_version_differs", version=CONTRACT_VERSION, of_worker=hello.version)
    if hello.bus != credential.bus:
        return Message.of("worker_token_of_other_bus", bus=credential.bus)
    if hello.bus not in buses:
        return Message.of("worker_bus_unknown", bus=hello.bus, known=", ".join(buses) or "-")
    return None
