"""One request is begun in each iteration of the event loop, and senders take turns."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress

import pytest
from starlette.types import Message, Receive, Scope, Send

from app.core.server.admission.turns import HEALTH, LoopTurns, RequestAdmission, sender_of


async def iterations(count: int) -> None:
    for _ in range(count):
        await asyncio.sleep(0)


async def test_the_first_begins_at_once_and_the_next_in_the_next_iteration() -> None:
    starts, begun = LoopTurns(), list[str]()

    async def begin(name: str, key: str) -> None:
        await starts.turn(key)
        begun.append(name)

    tasks = [asyncio.create_task(begin(f"a{n}", "a")) for n in range(50)]
    await asyncio.sleep(0)
    assert begun == ["a0"]
    tasks.append(asyncio.create_task(begin("b", "b")))
    await asyncio.gather(*tasks)
    assert begun.index("b") < 5
    assert len(begun) == 51


async def test_after_a_turn_of_a_sender_with_more_the_loop_is_free_as_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    loop, now, later = asyncio.get_running_loop(), 0.0, list[tuple[float, Callable[[], None]]]()
    starts, begun = LoopTurns(), list[str]()

    async def begin(key: str) -> None:
        nonlocal now
        await starts.turn(key)
        begun.append(key)
        now += 0.004

    monkeypatch.setattr(loop, "time", lambda: now)
    monkeypatch.setattr(loop, "call_later", lambda delay, call: later.append((delay, call)))
    tasks = [asyncio.create_task(begin("a")) for _ in range(3)]
    await iterations(10)
    assert (begun, [delay for delay, _ in later]) == (["a", "a"], [0.004])
    tasks.append(asyncio.create_task(begin("b")))
    await iterations(10)
    assert begun == ["a", "a"]
    later.pop()[1]()
    await asyncio.gather(*tasks)
    assert (begun, later) == (["a", "a", "a", "b"], [])


async def test_a_function_runs_in_its_turn_unless_it_is_cancelled() -> None:
    starts, begun = LoopTurns(), list[int]()
    cancels = [starts.run("a", lambda n=n: begun.append(n)) for n in range(5)]  # type: ignore[misc]
    assert begun == [0]
    for cancel in (cancels[0], cancels[2]):
        cancel()
    async with asyncio.timeout(60):
        await starts.turn("a")
    assert begun == [0, 1, 3, 4]


async def test_a_function_that_fails_does_not_keep_the_others() -> None:
    starts, begun, faults = LoopTurns(), list[str](), list[str]()
    asyncio.get_running_loop().set_exception_handler(lambda _, context: faults.append(context["message"]))

    def fail() -> None:
        raise KeyError

    starts.run("a", lambda: begun.append("first"))
    starts.run("a", fail)
    starts.run("a", lambda: begun.append("third"))
    async with asyncio.timeout(60):
        await starts.turn("a")
    assert (begun, len(faults)) == (["first", "third"], 1)


class Requests:
    """Requests of one client, admitted to an app that does nothing."""

    def __init__(self) -> None:
        self.ended = list[str]()
        """Their paths, in the order in which they ended."""
        self._admission = RequestAdmission(self._app)

    async def _app(self, scope: Scope, _receive: Receive, _send: Send) -> None:
        self.ended.append(scope["path"])

    async def request(self, path: str, *headers: tuple[bytes, bytes]) -> None:
        async def receive() -> Message:
            return {"type": "http.disconnect"}

        async def send(_: Message) -> None: ...

        scope: Scope = {"type": "http", "path": path, "headers": list(headers), "client": ("192.0.2.1", 1)}
        await self._admission(scope, receive, send)


async def test_polls_of_health_take_turns_among_themselves() -> None:
    requests = Requests()
    ended = requests.ended
    tasks = [asyncio.create_task(requests.request(HEALTH)) for _ in range(100)]
    await asyncio.sleep(0)
    assert len(ended) == 1
    await requests.request("/", (b"cookie", b"a"))
    assert len(ended) < 5
    await asyncio.gather(*tasks)


async def test_who_gave_up_waiting_costs_the_others_nothing() -> None:
    starts = LoopTurns()
    tasks = [asyncio.create_task(starts.turn("a")) for _ in range(5)]
    await asyncio.sleep(0)
    for task in tasks[1:4]:
        task.cancel()
    async with asyncio.timeout(60):
        await tasks[4]
        for task in tasks[1:4]:
            with suppress(asyncio.CancelledError):
                await task
        await starts.turn("a")


async def test_health_responds_before_a_thousand_requests() -> None:
    requests = Requests()
    ended = requests.ended
    tasks = [asyncio.create_task(requests.request("/login")) for _ in range(1000)]
    tasks.append(asyncio.create_task(requests.request(HEALTH)))
    while HEALTH not in ended:  # noqa: ASYNC110
        await asyncio.sleep(0)
    assert len(ended) < 5
    await asyncio.gather(*tasks)
    assert len(ended) == 1001


def test_a_sender_is_identified_by_the_credential() -> None:
    assert sender_of([(b"host", b"a"), (b"cookie", b"lineside_session=x")]) == b"lineside_session=x"
    assert sender_of([(b"authorization", b"Bearer y"), (b"cookie", b"x")]) == b"Bearer y"
    assert sender_of([(b"host", b"a")]) == b""
