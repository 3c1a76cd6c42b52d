"""Runs a blocking call in a thread that ends with the process."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

T = TypeVar("T")


async def in_thread(work: Callable[[], T], *, stop: Callable[[], None] | None = None) -> T:
    """Return what ``work`` returns. ``stop`` is called when the wait for it is canceled, and has to make it
    return. A thread that hangs in spite of that is abandoned: it delays neither the loop nor the end of the
    process, as a thread of a pool would."""
    done: Future[T] = Future()
    done.set_running_or_notify_cancel()

    def run() -> None:
        try:
            done.set_result(work())
        except BaseException as error:
            done.set_exception(error)

    threading.Thread(target=run, name="detached", daemon=True).start()
    try:
        return await asyncio.wrap_future(done)
    except asyncio.CancelledError:
        if stop is not None:
            stop()
        raise
