"""WebSockets that are lost together end one in each iteration of the event loop."""

from __future__ import annotations

import asyncio

from app.server.websocket import Endings


async def test_they_end_in_their_order_one_in_each_iteration() -> None:
    endings, iteration, ended = Endings(), 0, list[tuple[int, int]]()

    def end(number: int) -> None:
        ended.append((number, iteration))

    for number in range(3):
        endings.add(lambda number=number: end(number))  # type: ignore[misc]
    assert ended == []
    while iteration < 5:
        iteration += 1
        await asyncio.sleep(0)
    assert ended == [(0, 1), (1, 2), (2, 3)]


async def test_what_ends_meanwhile_has_its_turn_too() -> None:
    endings, ended = Endings(), list[str]()

    def end_both() -> None:
        ended.append("first")
        endings.add(lambda: ended.append("second"))

    endings.add(end_both)
    for _ in range(3):
        await asyncio.sleep(0)
    endings.add(lambda: ended.append("third"))
    for _ in range(3):
        await asyncio.sleep(0)
    assert ended == ["first", "second", "third"]


async def test_one_that_fails_does_not_keep_the_others() -> None:
    endings, ended, faults = Endings(), list[str](), list[str]()
    asyncio.get_running_loop().set_exception_handler(lambda _, context: faults.append(context["message"]))

    def fail() -> None:
        raise KeyError

    endings.add(fail)
    endings.add(lambda: ended.append("second"))
    for _ in range(3):
        await asyncio.sleep(0)
    assert (ended, len(faults)) == (["second"], 1)
