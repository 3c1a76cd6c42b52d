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
"""How often a right is checked that ends without a change, as the idle time of a session."""
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


async def run_while_allowed(
    run: Callable[[Send], Awaitable[None]], withdrawal: Withdrawal, send: Send, *, is_socket: bool = False
) -> None:
    """Run ``run``, which sends a response or has a WebSocket open, and end it when it is allowed no longer: a
    WebSocket by its close, a response in pieces where it is, also while it waits for its next piece or for a
    slow reader. A response that is sent at once costs nothing."""
    running, watch, is_over = asyncio.current_task(), None, False
    assert running is not None

    def end(_: asyncio.Task[None]) -> None:
        if not is_over:
            running.cancel()

    async def sending(message: Message) -> None:
        nonlocal watch
        if watch is None and message.get("more_body"):
            watch = _follow(withdrawal, end)
        await send(message)

    if is_socket:
        watch = _follow(withdrawal, end)
    try:
        await run(sending)
    except asyncio.CancelledError:
        if watch is None or not watch.done() or running.uncancel():
            raise
        if is_socket:
            with suppress(RuntimeError, OSError):
                await send({"type": "websocket.close", "code": NO_LONGER_SIGNED_IN})
        watch.result()  # raises where the right could not be looked up
    finally:
        is_over = True
        if watch is not None:
            watch.cancel()


def _follow(withdrawal: Withdrawal, end: Callable[[asyncio.Task[None]], None]) -> asyncio.Task[None]:
    watch = asyncio.create_task(withdrawal())
    watch.add_done_callback(end)
    return watch
