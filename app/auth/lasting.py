"""A WebSocket lasts for hours; whoever opened it may have lost the right to it since."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress

from starlette.types import Send

RECHECK_S = 20.0
NO_LONGER_SIGNED_IN = 4401
"""Close code: 4000 and the status that a request would be answered with."""


async def while_allowed(
    work: Awaitable[None],
    is_allowed: Callable[[], Awaitable[bool]],
    send: Send,
    every_s: float = RECHECK_S,
) -> None:
    """Run ``work``, a connection from its opening to its end; end it when it is allowed no longer."""
    task = asyncio.ensure_future(work)
    try:
        while not task.done():
            await asyncio.wait({task}, timeout=every_s)
            if not task.done() and not await is_allowed():
                await _end(task)
                with suppress(RuntimeError, OSError):
                    await send({"type": "websocket.close", "code": NO_LONGER_SIGNED_IN})
                return
        task.result()
    finally:
        await _end(task)


async def _end(task: asyncio.Future[None]) -> None:
    if not task.done():
        task.cancel()
        await asyncio.wait({task})
