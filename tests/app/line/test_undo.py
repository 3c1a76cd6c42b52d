"""What undoes the command of a person, from the command service on."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence

import pytest

from app.core.web.access import Person, Role
from bus.contract import (
    Action,
    Command,
    ParameterValue,
    SetLine,
    SetSpeed,
    Staged,
    Update,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from tests.app.stage import REMOTE, PlayedWorker, Stage, reading, result_of

ANNA, BEN = (Person(name, Role.ENGINEER, "session") for name in ("anna", "ben"))


def effects(action: Action) -> Sequence[Update]:
    match action:
        case SetSpeed(unit=unit, raw=raw):
            return [reading(unit, raw)]
        case SetLine(setpoints=setpoints):
            return [reading(unit, raw) for unit, raw in setpoints.items()]
        case WriteOutput(unit=unit, number=number, on=on):
            return [reading(unit, outputs=REMOTE | (1 << (number - 1) if on else 0))]
        case WriteParameter(unit=unit, number=number, raw=raw):
            return [ParameterValue(unit=unit, number=number, at=time.time(), raw=raw)]
    return []


@pytest.fixture
def obeying(worker: PlayedWorker) -> PlayedWorker:
    """Every command is verified, and read back."""

    async def play(command: Command) -> Sequence[Update]:
        outcome = "acknowledged" if isinstance(command.action, WriteAnalogOutput) else "verified"
        return [*effects(command.action), result_of(command, outcome)]

    worker.play = play
    return worker


async def send(stage: Stage, action: Action, id: str, person: Person = ANNA, **more: str) -> Action | None:
    """Send it from a page; what would undo it."""
    await stage.commands.send(person, action, confirm=True, id=id, origin="page", **more)
    offer = stage.commands.undo.offer(person, id)
    return None if offer is None else offer.action


@pytest.mark.usefixtures("obeying")
@pytest.mark.parametrize(
    ("action", "undo"),
    [
        (SetSpeed(unit=1, raw=1100), SetSpeed(unit=1, raw=1000)),
        (SetSpeed(unit=1, raw=1100, execute=False), None),
        (SetLine(setpoints={1: 900, 2: 800}), SetLine(setpoints={1: 1000, 2: 1000})),
        (WriteParameter(unit=1, number=12, raw=30), WriteParameter(unit=1, number=12, raw=20)),
        (WriteParameter(unit=1, number=6, raw=30), None),
        (SetSpeed(unit=1, raw=1000), None),
    ],
    ids=["set", "stage", "group", "parameter", "parameter never read", "no change"],
)
async def test_undo_is_the_command_back(stage: Stage, action: Action, undo: Action | None) -> None:
    assert await send(stage, action, "first-id") == undo
    assert stage.commands.undo.offer(BEN, "first-id") is None


@pytest.mark.usefixtures("obeying")
async def test_nothing_is_offered_that_would_be_another_value_in_the_scale_that_the_unit_has_now(
    stage: Stage,
) -> None:
    """Speed 0 needs no scale of its own, but what was there before it does."""
    undo = await send(stage, SetSpeed(unit=1, raw=0), "first-id", scales={1: {}})
    assert undo == SetSpeed(unit=1, raw=1000)
    stage.live.buses["dry-end"].apply([ParameterValue(unit=1, number=3, at=time.time(), raw=0)])
    assert stage.commands.undo.offer(ANNA, "first-id") is None


@pytest.mark.usefixtures("obeying")
async def test_a_change_of_several_has_its_undo_while_another_unit_holds_a_staged_value(stage: Stage) -> None:
    """That unit keeps its speed and its staged value (bus/line/commands/staging.py)."""
    stage.live.buses["dry-end"].apply([Staged(unit=16, at=time.time(), raw=700)])
    undo = await send(stage, SetLine(setpoints={1: 900, 2: 800}), "first-id")
    assert undo == SetLine(setpoints={1: 1000, 2: 1000})


@pytest.mark.usefixtures("obeying")
async def test_the_analog_output_is_known_once_it_was_acknowledged(stage: Stage) -> None:
    assert await send(stage, WriteAnalogOutput(unit=1, raw=300), "first-id") is None
    undo = await send(stage, WriteAnalogOutput(unit=1, raw=400), "second-id")
    assert undo == WriteAnalogOutput(unit=1, raw=300)


@pytest.mark.usefixtures("obeying")
async def test_an_undone_command_makes_room_for_the_one_before_it(stage: Stage) -> None:
    await send(stage, SetSpeed(unit=1, raw=1100), "first-id")
    undo = await send(stage, SetSpeed(unit=1, raw=1200), "second-id")
    assert undo is not None
    assert stage.commands.undo.offer(ANNA, "first-id") is None
    assert await send(stage, undo, "third-id", undoes="second-id") is None
    offer = stage.commands.undo.newest(ANNA, {1})
    assert offer is not None
    assert offer.action == SetSpeed(unit=1, raw=1000)
    stage.command_clock_ahead_s = 60.0
    assert stage.commands.undo.newest(ANNA, {1}) is None


@pytest.mark.parametrize(("unit", "known"), [(1, False), (2, True)])
async def test_of_two_commands_to_a_unit_at_once_neither_knows_what_was_before_it(
    stage: Stage, worker: PlayedWorker, unit: int, known: bool
) -> None:
    async def play(_: Command) -> Sequence[Update]:
        if len(worker.commands) < 2:
            return []
        return [
            update
            for sent in worker.commands
            for update in (*effects(sent.action), result_of(sent, "verified"))
        ]

    worker.play = play
    undone = await asyncio.gather(
        send(stage, SetSpeed(unit=1, raw=1100), "first-id"),
        send(stage, SetSpeed(unit=unit, raw=1100), "second-id", BEN),
    )
    assert [action is not None for action in undone] == [known, known]


@pytest.mark.usefixtures("obeying")
async def test_a_program_has_no_undo(stage: Stage) -> None:
    await stage.commands.send(ANNA, SetSpeed(unit=1, raw=1100), confirm=True, id="first-id")
    assert stage.commands.undo.offer(ANNA, "first-id") is None


async def test_on_a_page_of_several_units_undo_names_its_unit(stage: Stage, obeying: PlayedWorker) -> None:
    del obeying
    bus = stage.live.buses["dry-end"]
    for number, action in enumerate(
        (
            SetSpeed(unit=1, raw=1100, execute=True),
            WriteOutput(unit=1, number=1, on=True),
            WriteParameter(unit=1, number=6, raw=60),
        )
    ):
        await stage.commands.send(ANNA, action, confirm=True, id=f"c{number}", origin="page")
        offer = stage.commands.undo.offer(ANNA, f"c{number}")
        if offer is None:
            continue
        named = stage.commands.undo.newest(ANNA, {1}, names_unit=True)
        assert named is not None
        assert bus.units[1].settings.name in str(named.text)
        assert str(named.text) != str(offer.text)
