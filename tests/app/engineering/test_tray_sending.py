"""Sending what was reviewed of a change tray: in order, once, and no further than the first failure."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest

from app.core.web.admission.access import Person, Role
from app.engineering.tray.own_tray import TrayResult, send_changes
from app.line.commands.undo.changes import ValuePlace, Values, values_set
from app.people.audit.queries import Filter
from bus.contract import (
    Action,
    Command,
    ParameterValue,
    SetLine,
    SetSpeed,
    UnitOutcome,
    Update,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from bus.instants import monotonic_now
from bus.messages import Message
from tests.app.stage import PlayedWorker, Stage, reading, result_of

ANNA = Person("anna", Role.ENGINEER, "session")
BEN = Person("ben", Role.OPERATOR, "session")
SPEED_1, SPEED_2 = ValuePlace("setpoint", 1), ValuePlace("setpoint", 2)
OUTPUT, ANALOG, WINDOW = ValuePlace("output", 1, 3), ValuePlace("analog", 2), ValuePlace("parameter", 2, 12)
CHANGES = {WINDOW: 30, OUTPUT: 1, SPEED_1: 1100, ANALOG: 300, SPEED_2: 1200}
SENT: list[Action] = [
    SetLine(setpoints={1: 1100, 2: 1200}),
    WriteOutput(unit=1, number=3, on=True),
    WriteAnalogOutput(unit=2, raw=300),
    WriteParameter(unit=2, number=12, raw=30),
]


def playing(worker: PlayedWorker, result: Callable[[Command], Update]) -> None:
    async def play(command: Command) -> Sequence[Update]:
        return [result(command)]

    worker.play = play


def verified(command: Command) -> Update:
    return result_of(command, "acknowledged" if isinstance(command.action, WriteAnalogOutput) else "verified")


async def send(stage: Stage, changes: Values, person: Person = ANNA) -> list[TrayResult]:
    return await send_changes(
        stage.commands, person, stage.live.buses["dry-end"], changes, "a-tray", monotonic_now(), {}
    )


async def test_each_change_is_sent_once_in_order(stage: Stage, worker: PlayedWorker) -> None:
    playing(worker, verified)
    results = await send(stage, CHANGES)
    assert [command.action for command in worker.commands] == SENT
    assert {result.place: result.raw for result in results} == CHANGES
    assert all(result.is_done for result in results)
    again = await send(stage, CHANGES)
    assert [result.id for result in again] == [result.id for result in results]
    assert len(worker.commands) == len(SENT)


async def test_one_setpoint_is_set_alone(stage: Stage, worker: PlayedWorker) -> None:
    playing(worker, verified)
    await send(stage, {SPEED_2: 1200})
    assert [command.action for command in worker.commands] == [SetSpeed(unit=2, raw=1200)]


async def test_after_a_failure_nothing_more_is_sent(stage: Stage, worker: PlayedWorker) -> None:
    playing(
        worker,
        lambda command: (
            result_of(command, "refused") if isinstance(command.action, WriteOutput) else verified(command)
        ),
    )
    results = {result.place: result for result in await send(stage, CHANGES)}
    assert [command.action for command in worker.commands] == SENT[:2]
    assert {place for place, result in results.items() if result.is_done} == {SPEED_1, SPEED_2}
    assert results[ANALOG].part == results[WINDOW].part == Message("tray_stopped_before")


async def test_each_unit_of_a_change_of_several_has_its_own_result(
    stage: Stage, worker: PlayedWorker
) -> None:
    def one_of_two(command: Command) -> Update:
        parts = [UnitOutcome(1, "verified", read_back=1100), UnitOutcome(2, "unverified")]
        return result_of(command, "unverified", units=parts)

    playing(worker, one_of_two)
    results = await send(stage, {SPEED_1: 1100, SPEED_2: 1200, OUTPUT: 1})
    assert [result.is_done for result in results] == [True, False, False]


async def test_a_refusal_before_sending_stops_the_rest_too(stage: Stage, worker: PlayedWorker) -> None:
    playing(worker, verified)
    results = {result.place: result for result in await send(stage, {WINDOW: 30, ANALOG: 300}, BEN)}
    assert worker.commands == []
    refusal = results[ANALOG].part
    assert isinstance(refusal, Message)
    assert "role engineer" in str(refusal)
    assert results[WINDOW].part == Message("tray_stopped_before")


@pytest.mark.parametrize("changes", [{SPEED_1: 1100, SPEED_2: 1200}, {WINDOW: 30}])
async def test_events_name_the_tray_and_undo_goes_back(
    stage: Stage, worker: PlayedWorker, changes: Values
) -> None:
    playing(worker, verified)
    before = stage.commands.undo.values_now(changes)
    results = await send(stage, changes)
    found, _ = await stage.events.page(Filter(kind="command"), 10)
    assert {event["origin"] for event in found} == {"change tray"}
    for update in (reading(1, 1100), reading(2, 1200), ParameterValue(unit=2, number=12, at=1.0, raw=30)):
        stage.live.buses["dry-end"].apply([update])
    offer = stage.commands.undo.offer(ANNA, results[0].id)
    assert offer is not None
    assert values_set(offer.action, stage.live.buses["dry-end"]) == before
