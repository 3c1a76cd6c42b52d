"""Which commands are sent while the database is away, and what is known of them afterwards."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from app.audit.events.store import Filter
from app.commands.catalogue import COMMANDS, kind_of_command
from app.commands.service.record import MAX_REJECTIONS
from app.errors import Problem
from app.web.admission.access import Person, Role
from bus.contract import (
    Action,
    ChangeBaud,
    Command,
    ExecuteAll,
    ExecuteSpeed,
    ParameterValue,
    ReadParameters,
    ReadTrace,
    ScanBus,
    SetLine,
    SetSpeed,
    Staged,
    Update,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from tests.app.away_store import AwayDatabase
from tests.app.stage import PlayedWorker, Stage, reading, responding, result_of, snapshot, staged

ANNA = Person("anna", Role.ENGINEER, "session")
COMMANDED = 1000
"""Of each unit on the stage."""


@pytest.fixture
async def stage(tmp_path: Path) -> AsyncIterator[Stage]:
    async with staged(tmp_path, may_be_away=True) as built:
        yield built


@pytest.fixture
async def worker(stage: Stage) -> PlayedWorker:
    played = await stage.worker()
    played.play = responding("verified")
    # What the worker brought is stored: the next transaction is that of the test.
    await stage.recorder.recorded()
    return played


def away(stage: Stage) -> AwayDatabase:
    assert stage.away is not None
    return stage.away


async def commands(stage: Stage) -> list[tuple[Any, ...]]:
    found, _ = await stage.events.page(Filter(kind="command"), 100)
    return [(event["who"], event["new_raw"], event["outcome"]) for event in reversed(found)]


def follows(unit: int) -> ParameterValue:
    return ParameterValue(unit=unit, number=8, raw=1, at=1.0)


SLOWER = COMMANDED - 1
TABLE: list[tuple[Action, list[Update], bool]] = [
    (SetSpeed(unit=1, raw=0), [], True),
    (SetSpeed(unit=1, raw=SLOWER), [], True),
    (SetSpeed(unit=1, raw=COMMANDED), [], False),
    (SetSpeed(unit=1, raw=COMMANDED + 1), [], False),
    (SetSpeed(unit=1, raw=0, execute=False), [], False),
    (SetSpeed(unit=1, raw=SLOWER), [follows(1)], False),
    (SetSpeed(unit=1, raw=0), [follows(1)], False),
    (SetLine(setpoints={1: 0, 2: 0}), [], True),
    (SetLine(setpoints={1: SLOWER, 2: SLOWER}), [], True),
    (SetLine(setpoints={1: SLOWER, 2: COMMANDED}), [], False),
    (SetLine(setpoints={1: SLOWER, 2: SLOWER}), [follows(2)], False),
    (SetLine(setpoints={1: 0}), [Staged(unit=2, at=1.0, raw=COMMANDED + 1)], False),
    (SetLine(setpoints={1: 0}), [Staged(unit=2, at=1.0, raw=5)], True),
    (ExecuteSpeed(unit=1), [Staged(unit=1, at=1.0, raw=5)], False),
    (ExecuteAll(), [Staged(unit=1, at=1.0, raw=5)], False),
    (WriteOutput(unit=1, number=1, on=False), [], False),
    (WriteAnalogOutput(unit=1, raw=0), [], False),
    (WriteParameter(unit=1, number=20, raw=0), [], False),
    (ChangeBaud(baud=9600), [], False),
    (ScanBus(first=1, last=3), [], False),
    (ReadParameters(unit=1, numbers=[1]), [], False),
    (ReadTrace(since=0.0), [], False),
]


@pytest.mark.usefixtures("worker")
async def test_each_kind_is_judged_by_its_row(stage: Stage) -> None:
    [live] = stage.live.buses.values()
    assert {type(action) for action, _, _ in TABLE} == set(COMMANDS)
    for action, updates, slows in TABLE:
        live.take_snapshot(snapshot())
        live.apply([*(reading(unit, COMMANDED) for unit in live.units), *updates])
        assert kind_of_command(action).only_slows(action, live) is slows, (action, updates)


async def test_a_stop_is_logged_locally_sent_and_follows_with_its_outcome(
    stage: Stage, worker: PlayedWorker
) -> None:
    away(stage).leave()
    result = await stage.commands.send(ANNA, SetSpeed(unit=1, raw=0))
    assert result.outcome == "verified"
    together = await stage.commands.send(ANNA, SetLine(setpoints={1: 0, 2: 5}))
    assert together.outcome == "verified"
    assert len(worker.commands) == 2
    await away(stage).come_back()
    assert [outcome for _, _, outcome in await commands(stage)] == ["verified"] * 4
    assert (await stage.events.proof.verify({})).fault is None


async def test_what_makes_a_line_faster_is_refused_in_words_and_nothing_is_sent(
    stage: Stage, worker: PlayedWorker
) -> None:
    away(stage).leave()
    with pytest.raises(Problem) as refused:
        await stage.commands.send(ANNA, SetSpeed(unit=1, raw=COMMANDED + 1))
    assert (refused.value.status, refused.value.code) == (503, "store")
    assert refused.value.detail.startswith("Nothing was sent, as it cannot be logged: the database does not")
    with pytest.raises(Problem):
        stage.commands.check(ANNA, SetSpeed(unit=1, raw=COMMANDED + 1))
    assert worker.commands == []
    await away(stage).come_back()
    assert await commands(stage) == [("anna", COMMANDED + 1, "store")]


async def test_an_unconfirmed_intent_is_not_sent_where_it_is_no_stop(
    stage: Stage, worker: PlayedWorker
) -> None:
    away(stage).loses_commit = True
    with pytest.raises(Problem):
        await stage.commands.send(ANNA, WriteOutput(unit=1, number=1, on=True))
    away(stage).leave()
    await away(stage).come_back()
    assert worker.commands == []
    assert [outcome for _, _, outcome in await commands(stage)] == ["not_sent"]


@pytest.mark.usefixtures("worker")
async def test_a_flood_of_refused_commands_leaves_the_local_log_to_others(stage: Stage) -> None:
    away(stage).leave()
    for _ in range(MAX_REJECTIONS + 20):
        with pytest.raises(Problem):
            await stage.commands.send(ANNA, WriteOutput(unit=1, number=1, on=True))
    await away(stage).come_back()
    found, _ = await stage.events.page(Filter(kind="command"), 1000)
    assert MAX_REJECTIONS <= len(found) <= MAX_REJECTIONS + 10


async def test_a_key_gives_the_same_result_across_the_absence(stage: Stage, worker: PlayedWorker) -> None:
    await stage.commands.send(ANNA, SetSpeed(unit=1, raw=5), id="before")
    away(stage).leave()
    stop = SetSpeed(unit=1, raw=0)
    first = await stage.commands.send(ANNA, stop, id="mine")
    for service in (stage.commands, stage.commands_after_restart()):
        again = await service.send(ANNA, stop, id="mine")
        assert (again.outcome, again.at) == ("verified", first.at)
    with pytest.raises(Problem) as other:
        await stage.commands_after_restart().send(ANNA, SetSpeed(unit=2, raw=0), id="mine")
    assert other.value.code == "invalid"
    await away(stage).come_back()
    again = await stage.commands_after_restart().send(ANNA, stop, id="mine")
    assert (again.outcome, again.at) == ("verified", first.at)
    assert len(worker.commands) == 2


async def test_the_database_may_leave_and_return_while_a_command_is_under_way(
    stage: Stage, worker: PlayedWorker
) -> None:
    for goes_first in (False, True):
        if goes_first:
            away(stage).leave()

        async def turn(command: Command) -> list[Update]:
            if goes_first:  # noqa: B023 (awaited in this turn of the loop)
                await away(stage).come_back()
            else:
                away(stage).leave()
            return [result_of(command, "verified")]

        worker.play = turn
        result = await stage.commands.send(ANNA, SetSpeed(unit=1, raw=0), id=f"key {goes_first}")
        assert result.outcome == "verified"
        if not goes_first:
            await away(stage).come_back()
    assert [outcome for _, _, outcome in await commands(stage)] == ["verified"] * 2
    assert await stage.events.close_open_intents(None) == 0


async def test_a_database_that_takes_long_to_write_delays_no_stop(stage: Stage, worker: PlayedWorker) -> None:
    away(stage).writes.clear()
    try:
        result = await stage.commands.send(ANNA, SetSpeed(unit=1, raw=0))
        assert result.outcome == "verified"
        assert len(worker.commands) == 1
    finally:
        away(stage).writes.set()
    await away(stage).come_back()
    assert await commands(stage) == [("anna", 0, "verified")]


async def test_control_can_be_taken_and_released(tmp_path: Path) -> None:
    async with staged(tmp_path, may_be_away=True, control=True) as stage:
        worker = await stage.worker()
        worker.play = responding("verified")
        away(stage).leave()
        await stage.guards.take(ANNA)
        assert (await stage.commands.send(ANNA, SetSpeed(unit=1, raw=0))).outcome == "verified"
        await stage.guards.release(ANNA)
        await away(stage).come_back()
        found, _ = await stage.events.page(Filter(kind="control"), 10)
        assert [event["new"] for event in reversed(found)] == ["anna", None]
