"""Which worker may have a bus, and when another may take it. Pure: ``now`` is a monotonic time in seconds.

Commands are verified by what a worker reports: a bus goes to another worker only once the former one is
provably gone: it announced its end, or its connection ended and it did not return in time. A worker that
merely stalls (suspended, starved, behind a cut network) keeps its bus for longer.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from enum import Enum
from math import inf

from app.line.pipeline import OTHER_RELEASE
from app.version import VERSION
from bus.contract import CONTRACT_VERSION, Hello
from bus.instants import Monotonic
from bus.messages import Message


class Ending(Enum):
    """How the connection of a worker ended. The value: seconds for which its bus is kept for it."""

    LEFT = 0.0
    """It announced its end."""
    LOST = 5.0
    """The other side ended it: a worker that lives is back within 3 s."""
    CUT = 60.0
    """This side ended it, because nothing came: the worker may live, and resume."""


@dataclass(frozen=True, slots=True)
class Credential:
    """By which token, for which bus, and from which address a worker connected. ``own``: it is the child of
    this server."""

    token: str
    bus: str
    address: str
    own: bool = False

    def __str__(self) -> str:
        return f"{self.token} ({self.address})" if self.address else self.token


@dataclass(slots=True)
class Holder:
    """The worker that has a bus, connected or expected back. ``port_seen``: its port has been open."""

    worker: str
    credential: Credential
    port_seen: bool = False
    free_at: Monotonic = Monotonic(inf)

    def connection_ended(self, ending: Ending, now: Monotonic) -> None:
        """Keep the bus for its worker for the time that ``ending`` allows."""
        self.free_at = now + ending.value

    def is_same(self, worker: str, credential: Credential) -> bool:
        """Whether this is the very process, come back."""
        return self.worker == worker and self.credential.token == credential.token

    def yields_to(self, worker: str, credential: Credential, now: Monotonic) -> bool:
        """Whether the bus goes to this worker: to the same one always, to another when the holder is gone."""
        if self.is_same(worker, credential) or now >= self.free_at:
            return True
        if credential.own:
            # One process at most has the token of a child, and its next starts after its end.
            return self.credential.own and self.free_at < Monotonic(inf)
        # The child of a bus whose port is on another machine: the worker there must get it.
        return self.credential.own and not self.port_seen


def refusal(hello: Hello, credential: Credential, buses: Collection[str]) -> Message | None:
    """Why no bus is for this worker; None where there is one. ``buses``: those of the configuration."""
    if hello.version != CONTRACT_VERSION:
        versions = {"version": hello.version, "needed": CONTRACT_VERSION}
        return Message.of(OTHER_RELEASE, of_worker=hello.software, release=VERSION, **versions)
    if hello.bus != credential.bus:
        return Message.of("worker_token_of_other_bus", bus=credential.bus)
    if hello.bus not in buses:
        return Message.of("worker_bus_unknown", bus=hello.bus, known=", ".join(buses) or "-")
    return None
