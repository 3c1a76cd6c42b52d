"""Ends long-lived connections whose account has lost the right to them.

A change of the rights of an account, or the end of a session, is announced here; each open connection of the
account then looks up its own. None waits for its next piece or message.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from starlette.types import Message, Send

RECHECK_S = 20.0
"""For what ends without a change: the idle time of a session."""
NO_LONGER_SIGNED_IN = 4401
"""Close code: 4000 and the HTTP status of the same refusal."""

IsAllowed = Callable[[], Awaitable[bool]]
Withdrawal = Callable[[], Coroutine[Any, Any, None]]
"""Returns once a connection is allowed no longer."""


class Rechecks:
    """Makes open connections check again whether they are still allowed. ``count``: of all changes."""

    def __init__(self) -> None:
        self.count = 0
        self._open: dict[str, set[asyncio.Event]] = {}

    def now(self, account: str | None = None) -> None:
        """The rights of ``account`` may have changed, or a session of it has ended; None: of any account."""
        self.count += 1
        for each in self._open if account is None else (account,):
            for changed in self._open.get(each, ()):
                changed.set()

    async def until_withdrawn(
        self, account: str, is_allowed: IsAllowed, seen: int, every_s: float = RECHECK_S
    ) -> None:
        """Return once ``is_allowed`` denies: called at each change of ``account``, and every ``every_s``.
        ``seen``: the count before it was allowed."""
        with self._changes_of(account) as changed:
            if self.count != seen:
                changed.set()
            while True:
                with suppress(TimeoutError):
                    async with asyncio.timeout(every_s):
                        await changed.wait()
                changed.clear()
                if not await is_allowed():
                    return

    @contextmanager
    def _changes_of(self, account: str) -> Iterator[asyncio.Event]:
        changed = asyncio.Event()
        self._open.setdefault(account, set()).add(changed)
        try:
            yield changed
        finally:
            self._open[account].discard(changed)
            if not self._open[account]:
                del self._open[account]


async def while_allowed(work: Awaitable[None], withdrawal: Withdrawal, send: Send) -> None:
    """Run ``work``, a WebSocket from its opening to its end; end it when it is allowed no longer."""
    task, withdrawn = asyncio.ensure_future(work), asyncio.ensure_future(withdrawal())
    try:
        await asyncio.wait({task, withdrawn}, return_when=asyncio.FIRST_COMPLETED)
        if task.done():
            task.result()
            return
        await _end(task)
        with suppress(RuntimeError, OSError):
            await send({"type": "websocket.close", "code": NO_LONGER_SIGNED_IN})
        withdrawn.result()
    finally:
        await _end(withdrawn)
        await _end(task)


async def respond_while_allowed(
    respond: Callable[[Send], Awaitable[None]], withdrawal: Withdrawal, send: Send
) -> None:
    """Run ``respond``, which sends a response. One in pieces ends where it is when it is allowed no longer,
    also while it waits for its next piece or for a slow reader; one that is sent at once costs nothing."""
    response, watch, is_cut = asyncio.current_task(), None, False
    assert response is not None

    async def cut() -> None:
        nonlocal is_cut
        await withdrawal()
        is_cut = True
        response.cancel()

    async def sending(message: Message) -> None:
        nonlocal watch
        if watch is None and message.get("more_body"):
            watch = asyncio.create_task(cut())
        await send(message)

    try:
        await respond(sending)
    except asyncio.CancelledError:
        if not is_cut or response.uncancel():
            raise
    finally:
        if watch is not None:
            watch.cancel()


async def _end(task: asyncio.Future[None]) -> None:
    if not task.done():
        task.cancel()
        await asyncio.wait({task})
