"""Runs tasks that outlive the request which began them."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any


class Background:
    """Tasks that outlive the request which began them, ended with the app."""

    def __init__(self) -> None:
        self._tasks: dict[asyncio.Task[None], str] = {}

    def begin(self, work: Coroutine[Any, Any, None], name: str, bus: str = "") -> None:
        """Begin a task, which may belong to a bus."""
        task = asyncio.create_task(work, name=name)
        self._tasks[task] = bus
        task.add_done_callback(self._tasks.pop)

    async def settled(self) -> None:
        """Until nothing runs."""
        while self._tasks:
            await asyncio.gather(*tuple(self._tasks))

    async def close(self, bus: str | None = None) -> None:
        """End whatever still runs, or what belongs to one bus."""
        tasks = [task for task, of in self._tasks.items() if bus is None or of == bus]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
