"""The parts of the server start in order and end in reverse order, each even where another fails."""

from __future__ import annotations

import asyncio
import re

import pytest
from structlog.testing import capture_logs

from app.core import lifespan as module
from app.core.lifespan import Lifespan, StartError, Step
from app.errors import StoreError
from bus.messages import Message


class Played:
    """A lifespan whose steps note their names."""

    def __init__(self) -> None:
        self.lifespan = Lifespan()
        self.steps: list[str] = []

    def step(self, name: str, error: Exception | None = None) -> Step:
        async def run() -> None:
            self.steps.append(name)
            if error is not None:
                raise error

        return run

    def work(self, name: str) -> Step:
        async def run() -> None:
            try:
                await asyncio.Event().wait()
            finally:
                self.steps.append(name)

        return run

    async def run(self) -> None:
        async with self.lifespan.running():
            await asyncio.sleep(0)
            self.steps.append("served")


@pytest.fixture
def played() -> Played:
    return Played()


async def test_parts_start_in_order_and_end_in_reverse(played: Played) -> None:
    for name in ("store", "log", "alarms"):
        played.lifespan.add(name, start=played.step(f"{name} started"), end=played.step(f"{name} ended"))
    await played.run()
    started = ["store started", "log started", "alarms started"]
    assert played.steps == [*started, "served", "alarms ended", "log ended", "store ended"]


async def test_a_backlog_is_finished_then_works_are_canceled_then_parts_end(played: Played) -> None:
    played.lifespan.add("store", end=played.step("ended"))
    played.lifespan.add("log", played.work("canceled"), finish=played.step("finished"))
    await played.run()
    assert played.steps == ["served", "finished", "canceled", "ended"]


@pytest.mark.parametrize("error", [StoreError(Message("store_is_damaged")), ValueError("odd")])
async def test_a_failing_end_is_logged_and_the_others_follow(played: Played, error: Exception) -> None:
    played.lifespan.add("store", end=played.step("store ended"))
    played.lifespan.add("log", end=played.step("log ended", error), finish=played.step("written", error))
    with capture_logs() as logs:
        await played.run()
    assert played.steps == ["served", "written", "log ended", "store ended"]
    assert [(entry["event"], entry["part"], entry["why"]) for entry in logs] == [
        ("not ended", "log", str(error)),
        ("not ended", "log", str(error)),
    ]


async def test_a_backlog_that_cannot_be_written_is_given_up(
    played: Played, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MAX_FINISH_S", 0.01)
    played.lifespan.add("log", finish=asyncio.Event().wait, end=played.step("ended"))  # type: ignore[arg-type]
    with capture_logs() as logs:
        await played.run()
    assert played.steps == ["served", "ended"]
    assert [(entry["part"], entry["why"]) for entry in logs] == [("log", "TimeoutError")]


@pytest.mark.parametrize("error", [StoreError(Message("store_is_damaged")), ValueError("odd")])
async def test_a_failing_start_ends_those_begun_and_names_what_failed(
    played: Played, error: Exception
) -> None:
    for name in ("store", "log"):
        played.lifespan.add(name, end=played.step(f"{name} ended"))
    end, start = played.step("alarms ended"), played.step("alarms started", error)
    played.lifespan.add("alarms", played.work("worked"), start=start, end=end, finish=end)
    played.lifespan.add("swaps", start=played.step("swaps started"), end=played.step("swaps ended"))
    with pytest.raises(StartError, match=re.escape(f"could not start: alarms: {error}")):
        await played.run()
    assert played.steps == ["alarms started", "log ended", "store ended"]


async def test_a_failing_work_is_restarted_and_once_is_not(
    played: Played, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "RESTART_AFTER_S", 0.0)
    error = ValueError("odd")
    played.lifespan.add("log", played.step("worked", error), once=played.step("indexed", error))
    with capture_logs() as logs:
        async with played.lifespan.running(), asyncio.timeout(10):
            while played.steps.count("worked") < 3:  # noqa: ASYNC110
                await asyncio.sleep(0)
    assert played.steps.count("indexed") == 1
    assert {(entry["event"], entry["part"]) for entry in logs} == {("work failed", "log")}


async def test_a_work_that_loses_its_cancellation_is_canceled_again() -> None:
    """Python 3.11's `wait_for` loses one where its future is done at that moment."""
    lost = []

    async def work() -> None:
        try:
            await asyncio.sleep(60)
        except asyncio.CancelledError:
            lost.append("lost")
        await asyncio.sleep(60)

    lifespan = Lifespan()
    lifespan.add("work", once=work)
    async with lifespan.running():
        await asyncio.sleep(0)
    assert lost == ["lost"]
