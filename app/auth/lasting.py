"""Ends long-lived connections whose account has lost the right to them."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress

from starlette.types import Message, Send

from bus.instants import monotonic_now

RECHECK_S = 20.0
NO_LONGER_SIGNED_IN = 4401
"""Close code: 4000 and the HTTP status of the same refusal."""

IsAllowed = Callable[[], Awaitable[bool]]


class RightsEndedError(Exception):
    """A response may not go on."""


class Rechecks:
    """Makes open connections check again whether they are still allowed."""

    def __init__(self) -> None:
        self.count = 0
        self._next: asyncio.Future[None] | None = None

    def now(self) -> None:
        """The rights of an account have changed."""
        self.count += 1
        if self._next is not None and not self._next.done():
            self._next.set_result(None)
        self._next = None

    def next(self) -> asyncio.Future[None]:
        """Done at the next change."""
        if self._next is None:
            self._next = asyncio.get_running_loop().create_future()
        return self._next


async def while_allowed(
    work: Awaitable[None],
    is_allowed: IsAllowed,
    send: Send,
    rechecks: Rechecks,
    every_s: float = RECHECK_S,
) -> None:
    """Run ``work``, a WebSocket from its opening to its end; end it when it is allowed no longer."""
    task, seen = asyncio.ensure_future(work), rechecks.count
    try:
        while not task.done():
            if rechecks.count == seen:
                either = {task, rechecks.next()}
                await asyncio.wait(either, timeout=every_s, return_when=asyncio.FIRST_COMPLETED)
            seen = rechecks.count
            if not task.done() and not await is_allowed():
                await _end(task)
                with suppress(RuntimeError, OSError):
                    await send({"type": "websocket.close", "code": NO_LONGER_SIGNED_IN})
                return
        task.result()
    finally:
        await _end(task)


def sending_while_allowed(send: Send, is_allowed: IsAllowed, rechecks: Rechecks) -> Send:
    """``send`` of a response that may take long. Rights are checked again after they have changed, and every
    :data:`RECHECK_S` seconds, before the next piece. Raises RightsEndedError."""
    seen, seen_at = rechecks.count, monotonic_now()

    async def sending(message: Message) -> None:
        nonlocal seen, seen_at
        if message.get("more_body") and (rechecks.count != seen or monotonic_now() - seen_at >= RECHECK_S):
            seen, seen_at = rechecks.count, monotonic_now()
            if not await is_allowed():
                raise RightsEndedError
        await send(message)

    return sending


async def _end(task: asyncio.Future[None]) -> None:
    if not task.done():
        task.cancel()
        await asyncio.wait({task})
