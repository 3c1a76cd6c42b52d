"""Turns of the event loop and at what costs much: one key does not wait for all that another has sent."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from app.core.server.turns import MAX_REST_S, FairQueue, LoopTurns, TooManyWaitingError

MAX_OF_ONE, MAX_WAITING = 5, 200


async def iterations(count: int) -> None:
    for _ in range(count):
        await asyncio.sleep(0)


async def test_the_first_runs_at_once_and_the_keys_take_turns() -> None:
    turns, begun = LoopTurns(), list[str]()
    for number in range(50):
        turns.run("a", lambda name=f"a{number}": begun.append(name))  # type: ignore[misc]
    assert begun == ["a0"]
    turns.run("b", lambda: begun.append("b"))
    async with asyncio.timeout(60):
        while len(begun) < 51:  # noqa: ASYNC110
            await asyncio.sleep(0)
    assert begun.index("b") < 5


async def test_after_a_turn_of_a_key_with_more_the_loop_is_free_as_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    loop, now, later = asyncio.get_running_loop(), 0.0, list[tuple[float, Callable[[], None]]]()
    turns, begun = LoopTurns(), list[str]()

    def spend(seconds: float) -> None:
        nonlocal now
        now += seconds

    def begin(key: str) -> None:
        begun.append(key)
        spend(0.003)
        loop.call_soon(spend, 0.001)  # as the app's first step

    monkeypatch.setattr(loop, "time", lambda: now)
    monkeypatch.setattr(loop, "call_later", lambda delay, call: later.append((round(delay, 6), call)))
    for _ in range(3):
        turns.run("a", lambda: begin("a"))
    await iterations(10)
    assert (begun, [delay for delay, _ in later]) == (["a"], [0.004])
    turns.run("b", lambda: begin("b"))
    await iterations(10)
    assert begun == ["a"]
    later.pop()[1]()
    await iterations(10)
    assert (begun, len(later)) == (["a", "a"], 1)
    later.pop()[1]()
    await iterations(10)
    assert (begun, later) == (["a", "a", "b", "a"], [])


async def test_a_function_that_fails_does_not_keep_the_others() -> None:
    turns, begun, faults = LoopTurns(), list[str](), list[str]()
    asyncio.get_running_loop().set_exception_handler(lambda _, context: faults.append(context["message"]))

    def fail() -> None:
        raise KeyError

    turns.run("a", lambda: begun.append("first"))
    turns.run("a", fail)
    turns.run("a", lambda: begun.append("third"))
    async with asyncio.timeout(60):
        while len(begun) < 2:  # noqa: ASYNC110
            await asyncio.sleep(0)
    assert (begun, len(faults)) == (["first", "third"], 1)


class Scene:
    """Every waiter holds the turn until ``go`` lets one of them end."""

    def __init__(self, at_once: int = 1) -> None:
        self.turns: FairQueue[str] = FairQueue(at_once, 1, MAX_OF_ONE, MAX_WAITING)
        self.order: list[str] = []
        self.running = 0
        self.most_running = 0
        self._go = asyncio.Semaphore(0)
        self.tasks: list[asyncio.Task[None]] = []

    async def _one(self, who: str, place: str, known: bool) -> None:
        async with self.turns.turn(place, known=known):
            self.order.append(who)
            self.running += 1
            self.most_running = max(self.most_running, self.running)
            await self._go.acquire()
            self.running -= 1

    async def comes(self, who: str, place: str = "", *, known: bool = False) -> asyncio.Task[None]:
        task = asyncio.create_task(self._one(who, place or who, known))
        self.tasks.append(task)
        await self.settle()
        return task

    async def settle(self) -> None:
        for _ in range(10):
            await asyncio.sleep(0)

    async def all_end(self) -> list[str]:
        for _ in self.tasks:
            self._go.release()
            await self.settle()
        await asyncio.gather(*self.tasks, return_exceptions=True)
        return self.order


async def test_one_place_takes_one_turn_at_a_time() -> None:
    scene = Scene(at_once=2)
    for number in range(4):
        await scene.comes(f"a{number}", "a")
    assert scene.order == ["a0"]
    await scene.comes("b0", "b")
    assert scene.order == ["a0", "b0"]
    assert await scene.all_end() == ["a0", "b0", "a1", "a2", "a3"]
    assert scene.most_running == 2


async def test_places_take_turns() -> None:
    scene = Scene()
    for number in range(4):
        await scene.comes(f"a{number}", "a")
    await scene.comes("b0", "b")
    await scene.comes("c0", "c")
    assert await scene.all_end() == ["a0", "a1", "b0", "c0", "a2", "a3"]


async def test_a_place_that_is_known_waits_for_one_stranger_at_most() -> None:
    """A hundred strangers held one lock for two seconds."""
    scene = Scene()
    for number in range(50):
        await scene.comes(f"stranger{number}")
    await scene.comes("ann", known=True)
    order = await scene.all_end()
    assert order.index("ann") <= 2


async def test_what_waits_is_bounded() -> None:
    scene = Scene()
    await scene.comes("first", "a")
    waiting = [await scene.comes(f"a{number}", "a") for number in range(MAX_OF_ONE)]
    too_many = await scene.comes("one more", "a")
    with pytest.raises(TooManyWaitingError):
        await too_many
    assert not any(task.done() for task in waiting)
    for number in range(MAX_WAITING):
        await scene.comes(f"stranger{number}")
    refused = [task for task in scene.tasks if task.done()]
    assert len(refused) > MAX_WAITING // 2
    known = await scene.comes("ann", known=True)
    assert not known.done(), "strangers leave room"
    await scene.all_end()


async def test_who_goes_away_while_waiting_holds_nothing_up() -> None:
    scene = Scene()
    await scene.comes("a")
    gone = await scene.comes("b")
    await scene.comes("c")
    gone.cancel()
    await scene.settle()
    assert await scene.all_end() == ["a", "c"]


async def test_who_goes_away_at_its_turn_gives_it_on() -> None:
    scene = Scene()
    first = await scene.comes("a")
    second = await scene.comes("b")
    await scene.comes("c")
    first.cancel()
    second.cancel()
    await scene.settle()
    assert "c" in scene.order
    await scene.all_end()


@pytest.mark.parametrize(("turn_s", "rest_s"), [(0.003, 0.012), (1.0, MAX_REST_S)])
async def test_a_place_rests_in_proportion_to_its_turn(
    monkeypatch: pytest.MonkeyPatch, turn_s: float, rest_s: float
) -> None:
    loop = asyncio.get_running_loop()
    now, ends = 0.0, list[tuple[float, Callable[..., None], str]]()
    monkeypatch.setattr(loop, "time", lambda: now)
    monkeypatch.setattr(loop, "call_later", lambda delay, end, key: ends.append((delay, end, key)))
    turns: FairQueue[str] = FairQueue(2, 1, 5, rest=4.0)
    async with turns.turn("a"):
        now += turn_s

    async def next_of_the_same() -> None:
        async with turns.turn("a"):
            pass

    waiting = asyncio.create_task(next_of_the_same())
    await asyncio.sleep(0)
    async with turns.turn("b"):
        assert not waiting.done()
    delay, end, key = ends[0]
    assert (round(delay, 6), key) == (rest_s, "a")
    end(key)
    await waiting
