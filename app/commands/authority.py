"""Whether the sender of a command still has the right to it while it is in progress."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any

import msgspec

from bus.contract import Result
from bus.messages import Message, joined

RECHECK_S = 0.25
"""Most commands are over by then; a change of the baud rate or of many units is not."""


async def while_permitted(
    work: Coroutine[Any, Any, Result],
    why_not: Callable[[], Awaitable[Message | None]],
    give_up: Callable[[], Awaitable[None]],
) -> Result:
    """Return the result of ``work``, a command in progress. When ``why_not`` gives a reason, ``give_up`` is
    called once, the worker stops where nothing is half done, and the reason precedes the result's message."""
    task = asyncio.ensure_future(work)
    reason: Message | None = None
    try:
        while not task.done():
            await asyncio.wait({task}, timeout=RECHECK_S)
            if not task.done() and reason is None:
                reason = await why_not()
                if reason is not None:
                    await give_up()
        result = task.result()
    finally:
        task.cancel()
    return msgspec.structs.replace(result, message=joined((reason, result.message)))
