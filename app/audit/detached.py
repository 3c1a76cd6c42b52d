"""Blocking work that nothing waits for beyond its time, not even the end of the process."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from typing import Any, TypeVar

T = TypeVar("T")


class Detached:
    """Runs one task at a time in a separate thread. An executor would be joined at the end of the
    process, and a network file system that hangs would keep that from ending."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._running: Future[Any] = Future()
        self._running.set_result(None)

    async def run(self, work: Callable[[], T], within_s: float) -> T:
        """The result of ``work``, or what it raises. Raises TimeoutError when it takes longer; also when
        earlier work still does, and then nothing was begun."""
        async with asyncio.timeout(within_s):
            if not self._running.done():
                with suppress(Exception):
                    await asyncio.wrap_future(self._running)
            self._running = started = self._start(work)
            return await asyncio.wrap_future(started)

    def _start(self, work: Callable[[], T]) -> Future[T]:
        future: Future[T] = Future()
        # From here on it cannot be canceled: the thread runs to its end.
        future.set_running_or_notify_cancel()

        def run() -> None:
            try:
                future.set_result(work())
            except Exception as error:
                future.set_exception(error)

        threading.Thread(target=run, name=self._name, daemon=True).start()
        return future
