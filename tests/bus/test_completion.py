"""A coroutine continues in the call that completes what it awaits."""

from __future__ import annotations

import asyncio

import pytest

from bus.line.link import Completion, run_at_once


async def test_what_awaits_it_has_run_when_set_returns() -> None:
    first: Completion[int] = Completion()
    second: Completion[int] = Completion()
    received: list[int] = []

    async def steps() -> str:
        received.append(await first)
        received.append(await second)
        return "over"

    running = asyncio.create_task(run_at_once(steps()))
    await asyncio.sleep(0)
    first.set(1)
    assert received == [1]
    second.set(2)
    assert received == [1, 2]
    assert await running == "over"


async def test_a_result_set_before_it_is_awaited_is_no_wait() -> None:
    completion: Completion[int] = Completion()

    async def steps() -> int:
        completion.set(7)
        return await completion

    assert await run_at_once(steps()) == 7


async def test_an_error_ends_what_runs_it_and_not_what_sets_it() -> None:
    completion: Completion[None] = Completion()

    async def steps() -> None:
        await completion
        raise ValueError("broken")

    running = asyncio.create_task(run_at_once(steps()))
    await asyncio.sleep(0)
    completion.set(None)
    with pytest.raises(ValueError, match="broken"):
        await running


async def test_a_coroutine_that_is_canceled_is_closed_and_not_resumed() -> None:
    completion: Completion[None] = Completion()
    events: list[str] = []

    async def steps() -> None:
        try:
            await completion
            events.append("resumed")
        finally:
            events.append("closed")

    running = asyncio.create_task(run_at_once(steps()))
    await asyncio.sleep(0)
    running.cancel()
    with pytest.raises(asyncio.CancelledError):
        await running
    completion.set(None)
    assert events == ["closed"]
