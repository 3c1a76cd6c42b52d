"""Turns at what costs much: an account has few at a time, and its others wait while other people's go on."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf

from fastapi import Depends

from app.core.server.turns import FairQueue
from app.core.web.admission.access import Viewer

MAX_AT_ONCE = 2
MAX_WAITING = 30
"""How many searches, and how many downloads, of an account may wait."""
MAX_READS = 2
REST, MOST_REST_S = 2.0, 0.5
"""How many times as long as a read took its place stays free, and for how long at most. A command needs the
event loop some twenty times, and would otherwise wait for another page of that account each time."""
MAX_WAITING_READS = 200
"""How many other reads of an account may wait."""


@dataclass(frozen=True)
class Turns:
    """The queues of one app, each by account."""

    searches: FairQueue[str] = field(default_factory=lambda: FairQueue(inf, MAX_AT_ONCE, MAX_WAITING))
    downloads: FairQueue[str] = field(default_factory=lambda: FairQueue(inf, MAX_AT_ONCE, MAX_WAITING))
    reads: FairQueue[str] = field(
        default_factory=lambda: FairQueue(
            inf, MAX_READS, MAX_WAITING_READS, rest=REST, most_rest_s=MOST_REST_S
        )
    )
    """Everything else that is read."""


async def _search(_: Viewer) -> None: ...


async def _download(_: Viewer) -> None: ...


SEARCH, DOWNLOAD = Depends(_search), Depends(_download)
"""For ``dependencies=[SEARCH]`` of a route, which has its turn from before it runs until its response is sent
(`app.core.web.admission.routes.RouteGuard`)."""
