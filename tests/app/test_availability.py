"""Waiting for what a thread does at a database that may be away."""

from __future__ import annotations

import asyncio
import gc
from contextlib import suppress
from typing import Any

import pytest

from app.database.availability import in_time
from app.errors import StoreUnavailableError
from bus.messages import Message

GONE = StoreUnavailableError(Message("store_no_response"))


async def test_a_result_a_failure_and_what_takes_too_long() -> None:
    loop = asyncio.get_running_loop()
    done, failed, hanging = (loop.create_future() for _ in range(3))
    done.set_result(7)
    failed.set_exception(GONE)
    assert await in_time(done) == 7
    for work in (failed, hanging):
        with pytest.raises(StoreUnavailableError):
            await in_time(work, 0.01)
    assert hanging.cancelled()


async def test_a_failure_after_its_caller_was_canceled_is_not_logged_as_an_error_of_the_program() -> None:
    loop, logged = asyncio.get_running_loop(), list[dict[str, Any]]()
    loop.set_exception_handler(lambda _, context: logged.append(context))
    work = loop.create_future()
    waiting = asyncio.create_task(in_time(work))
    await asyncio.sleep(0)
    waiting.cancel()
    with suppress(asyncio.CancelledError):
        await waiting
    work.set_exception(GONE)
    await asyncio.sleep(0)
    del work, waiting
    gc.collect()
    await asyncio.sleep(0)
    assert logged == []
