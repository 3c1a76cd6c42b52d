"""Undo of commands, from the command service on, and judged by a model: the history of two units' values."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from msgspec.structs import replace

from app.core.web.access import Person, Role
from app.line.commands.undo import SentCommand, UndoStack, ValuePlace
from bus.contract import (
    Action,
    Command,
    ExecuteAll,
    ParameterValue,
    SetLine,
    SetSpeed,
    Staged,
    UnitOutcome,
    Update,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from bus.messages import Message
from tests.app.complete_app import House
from tests.app.fake_worker import REMOTE, PlayedWorker, reading, result_of

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


async def send(site: House, action: Action, id: str, person: Person = ANNA, **more: str) -> Action | None:
    """Send it from a page; what would undo it."""
    await site.commands.send(person, action, confirm=True, id=id, origin="page", **more)
    offer = site.commands.undo.offer(person, id)
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
async def test_undo_is_the_command_back(site: House, action: Action, undo: Action | None) -> None:
    assert await send(site, action, "first-id") == undo
    assert site.commands.undo.offer(BEN, "first-id") is None


@pytest.mark.usefixtures("obeying")
async def test_nothing_is_offered_that_would_be_another_value_in_the_scale_that_the_unit_has_now(
    site: House,
) -> None:
    """Speed 0 needs no scale of its own, but what was there before it does."""
    undo = await send(site, SetSpeed(unit=1, raw=0), "first-id", scales={1: {}})
    assert undo == SetSpeed(unit=1, raw=1000)
    site.live.apply([ParameterValue(unit=1, number=3, at=time.time(), raw=0)])
    assert site.commands.undo.offer(ANNA, "first-id") is None


@pytest.mark.usefixtures("obeying")
async def test_a_unit_that_was_taken_out_of_remote_could_only_reject_the_undo(site: House) -> None:
    site.live.apply([ParameterValue(unit=1, number=19, at=time.time(), raw=1)])
    assert await send(site, WriteParameter(unit=1, number=19, raw=0), "first-id") is None


@pytest.mark.usefixtures("obeying")
async def test_a_change_of_several_has_its_undo_while_another_unit_holds_a_staged_value(site: House) -> None:
    """That unit keeps its speed and its staged value (bus/line/commands/staging.py)."""
    site.live.apply([Staged(unit=16, at=time.time(), raw=700)])
    undo = await send(site, SetLine(setpoints={1: 900, 2: 800}), "first-id")
    assert undo == SetLine(setpoints={1: 1000, 2: 1000})


async def test_what_was_staged_is_executed_and_undone_beside_a_unit_that_does_not_respond(
    site: House, worker: PlayedWorker
) -> None:
    silent = UnitOutcome(16, "unverified", Message.of("unit_no_response", unit=16))
    in_local = UnitOutcome(2, "unverified", read_back=1000)
    outcomes = [UnitOutcome(1, "verified", read_back=900), in_local, silent]

    async def play(command: Command) -> Sequence[Update]:
        return [reading(1, 900), replace(result_of(command, "unverified"), units=outcomes)]

    worker.play = play
    site.live.apply([Staged(unit=1, at=time.time(), raw=900), Staged(unit=2, at=time.time(), raw=900)])
    assert await send(site, ExecuteAll(), "first-id") == SetSpeed(unit=1, raw=1000)


@pytest.mark.usefixtures("obeying")
async def test_the_analog_output_is_known_once_it_was_acknowledged(site: House) -> None:
    assert await send(site, WriteAnalogOutput(unit=1, raw=300), "first-id") is None
    undo = await send(site, WriteAnalogOutput(unit=1, raw=400), "second-id")
    assert undo == WriteAnalogOutput(unit=1, raw=300)


@pytest.mark.usefixtures("obeying")
async def test_an_undone_command_makes_room_for_the_one_before_it(
    site: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    await send(site, SetSpeed(unit=1, raw=1100), "first-id")
    undo = await send(site, SetSpeed(unit=1, raw=1200), "second-id")
    assert undo is not None
    assert site.commands.undo.offer(ANNA, "first-id") is None
    assert await send(site, undo, "third-id", undoes="second-id") is None
    offer = site.commands.undo.newest(ANNA, {1})
    assert offer is not None
    assert offer.action == SetSpeed(unit=1, raw=1000)
    later = time.monotonic() + 60.0
    monkeypatch.setattr(site.commands.undo, "_clock", lambda: later)
    assert site.commands.undo.newest(ANNA, {1}) is None


@pytest.mark.parametrize(("unit", "known"), [(1, False), (2, True)])
async def test_of_two_commands_to_a_unit_at_once_neither_knows_what_was_before_it(
    site: House, worker: PlayedWorker, unit: int, known: bool
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
        send(site, SetSpeed(unit=1, raw=1100), "first-id"),
        send(site, SetSpeed(unit=unit, raw=1100), "second-id", BEN),
    )
    assert [action is not None for action in undone] == [known, known]


@pytest.mark.usefixtures("obeying")
async def test_a_program_has_no_undo(site: House) -> None:
    await site.commands.send(ANNA, SetSpeed(unit=1, raw=1100), confirm=True, id="first-id")
    assert site.commands.undo.offer(ANNA, "first-id") is None


async def test_on_a_page_of_several_units_undo_names_its_unit(site: House, obeying: PlayedWorker) -> None:
    del obeying
    bus = site.live
    for number, action in enumerate(
        (
            SetSpeed(unit=1, raw=1100, execute=True),
            WriteOutput(unit=1, number=1, on=True),
            WriteParameter(unit=1, number=6, raw=60),
        )
    ):
        await site.commands.send(ANNA, action, confirm=True, id=f"c{number}", origin="page")
        offer = site.commands.undo.offer(ANNA, f"c{number}")
        if offer is None:
            continue
        named = site.commands.undo.newest(ANNA, {1}, names_unit=True)
        assert named is not None
        assert bus.units[1].settings.name in str(named.text)
        assert str(named.text) != str(offer.text)
    found = site.commands.undo.newest(ANNA, {1}, "setpoint")
    assert found is None or found.sets_speed, "the place of a setpoint offers no undo of an output"


SPEED_1, SPEED_2, OUTPUT = ValuePlace("setpoint", 1), ValuePlace("setpoint", 2), ValuePlace("output", 1, 3)
PLACES = st.sampled_from([SPEED_1, SPEED_2, OUTPUT])
GROUPS = st.lists(PLACES, min_size=1, max_size=3, unique=True)
LASTS_S = 60.0
Entry = tuple[float, str, str, dict[ValuePlace, int], dict[ValuePlace, int], bool]


class UndoModel(RuleBasedStateMachine):
    """``self.log``: time, id, who, the value of each place before and after, whether the former is known."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0
        self.values: dict[ValuePlace, int] = dict.fromkeys(
            (ValuePlace("setpoint", 1), ValuePlace("setpoint", 2), ValuePlace("output", 1, 3)), 0
        )
        self.commands = 0
        self.log: list[Entry] = []
        self.stack = UndoStack(lambda values: all(self.values[place] == raw for place, raw in values.items()))

    def expected(self, who: str) -> dict[str, dict[ValuePlace, int]]:
        """By the id of each command that this person can undo now: what was there before it."""
        found = {}
        mine = [entry for entry in self.log if entry[2] == who]
        for position, (at, id, _, before, new, known) in enumerate(mine):
            superseded = any(new.keys() & later[4].keys() for later in mine[position + 1 :])
            present = {place: self.values[place] for place in new}
            if known and present == new and not superseded and self.now < at + LASTS_S:
                found[id] = before
        return found

    @rule(seconds=st.sampled_from([1.0, 29.0, 30.0, 59.0, 60.0]))
    def time_passes(self, seconds: float) -> None:
        self.now += seconds

    @rule(who=st.sampled_from(["anna", "ben"]), places=GROUPS, raw=st.integers(0, 2), known=st.booleans())
    def command(self, who: str, places: list[ValuePlace], raw: int, known: bool) -> None:
        before, new = {place: self.values[place] for place in places}, dict.fromkeys(places, raw)
        self.values |= new
        self.commands += 1
        id = f"{self.commands}"
        self.log.append((self.now, id, who, before, new, known))
        self.stack.push(who, SentCommand(id, new, before if known else {}, self.now))

    @rule(place=PLACES, raw=st.integers(0, 2))
    def keypad(self, place: ValuePlace, raw: int) -> None:
        self.values[place] = raw

    @precondition(lambda self: self.expected("anna"))
    @rule(data=st.data())
    def undo(self, data: st.DataObject) -> None:
        can = self.expected("anna")
        id = data.draw(st.sampled_from(sorted(can)))
        found = self.stack.find("anna", id, self.now)
        assert found is not None
        self.values |= found.before
        self.stack.undone("anna", id)
        self.log = [entry for entry in self.log if entry[1] != id]

    @rule(who=st.sampled_from(["anna", "ben"]))
    def line_is_set_to_zero(self, who: str) -> None:
        self.stack.clear(who)
        self.log = [entry for entry in self.log if entry[2] != who]

    @invariant()
    def offers_go_back_to_the_former_values(self) -> None:
        for who in ("anna", "ben"):
            can = self.expected(who)
            for _, id, *_ in self.log:
                found = self.stack.find(who, id, self.now)
                assert (None if found is None else dict(found.before)) == can.get(id)
            for units in ({1}, {1, 2}):
                mine = [id for id, before in can.items() if {place.unit for place in before} <= units]
                newest = self.stack.newest(who, self.now, units)
                assert (newest.id if newest else None) == (max(mine, key=int) if mine else None)


TestUndo = UndoModel.TestCase
