"""Turns at what costs much: an account has few at a time, and its others wait while other people's go on."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

from fastapi import Depends

from app.errors import Problem
from app.web.access import Viewer

AT_ONCE = 2
MOST_WAITING = 30


@dataclass(slots=True)
class _Queue:
    gate: asyncio.Semaphore = field(default_factory=lambda: asyncio.Semaphore(AT_ONCE))
    inside: int = 0
    """Those that have a turn and those that wait for one."""


class Turns:
    """By account."""

    def __init__(self) -> None:
        self._queues: dict[str, _Queue] = {}

    @asynccontextmanager
    async def turn(self, account: str) -> AsyncIterator[None]:
        """Wait for a turn, and have it. Raises Problem 429 where too many wait."""
        queue = self._queues.setdefault(account, _Queue())
        if queue.inside >= AT_ONCE + MOST_WAITING:
            detail = "too many of your searches and downloads wait already; let some end"
            raise Problem(429, "too_many", detail).with_headers(Retry_After="2")
        queue.inside += 1
        try:
            async with queue.gate:
                yield
        finally:
            queue.inside -= 1
            if not queue.inside:
                del self._queues[account]


def in_turn(turns: Turns) -> Any:
    """``dependencies=[SEARCH]`` of a route: one turn from before it runs until its response is sent."""

    async def take_turn(person: Viewer) -> AsyncIterator[None]:
        async with turns.turn(person.account):
            yield

    return Depends(take_turn)


searches, downloads = Turns(), Turns()
SEARCH, DOWNLOAD = in_turn(searches), in_turn(downloads)
