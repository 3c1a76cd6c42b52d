"""A typed value is executed as the unit shows it, or not at all, whatever is done at its keypad.

The units are those written from the manual alone; their keypads change the scale at random moments. What
the app does is done here with what the worker has reported: it converts by that, and states by what.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from functools import partial
from math import inf
from typing import cast

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from bus.catalogue.parameters import (
    ANALOG_OUT_HIGH,
    ANALOG_OUT_LOW,
    ANALOG_OUT_SOURCE,
    AT_SPEED_WINDOW,
    DECIMALS,
    FOLLOWER_MODE,
    MAX_DISPLAY,
)
from bus.catalogue.values import is_follower, ratio_raw, speed_raw
from bus.contract import (
    Action,
    Command,
    ExecuteAll,
    ExecuteSpeed,
    Result,
    SetLine,
    SetSpeed,
    Staged,
    UnitScale,
    WriteAnalogOutput,
    WriteParameter,
)
from bus.errors import CallerError
from bus.settings import wire_seconds
from bus.simulator.line import SimulatedLine
from bus.simulator.ports import Wake
from tests.bus.virtual_line import EPOCH, VirtualLine, played, run
from tests.path.independent_unit import Unit, cut_frame
from tests.sizes import sizes

UNITS = 3
SCALE = (MAX_DISPLAY, FOLLOWER_MODE, DECIMALS)


class KeypadUnit(Unit):
    """A unit with a display and a keypad. ``shown``: since when its display shows which setpoint."""

    def __init__(self, address: int) -> None:
        super().__init__(address)
        self.commanded = self.actual = 500
        self.shown: list[tuple[float, str]] = [(0.0, self.display(self.commanded))]
        self.tolerances: list[tuple[float, str]] = [(0.0, self.tolerance)]

    def display(self, raw: int) -> str:
        """A setpoint as it stands there."""
        places = 4 if self.values[FOLLOWER_MODE] else self.values[DECIMALS]
        return f"{raw / 10**places:.{places}f}"

    @property
    def tolerance(self) -> str:
        """As it stands there: of a speed, also in a follower."""
        places = self.values[DECIMALS]
        return f"{self.values[AT_SPEED_WINDOW] / 10**places:.{places}f}"

    def note(self, now: float) -> None:
        """What the display shows from ``now`` on."""
        self.shown.append((now, self.display(self.commanded)))
        self.tolerances.append((now, self.tolerance))


@dataclass
class Keypads:
    """The units of a cable, in the place of the simulated line."""

    units: list[KeypadUnit]
    _buffer: bytearray = field(default_factory=bytearray)
    _sent: list[tuple[float, bytes]] = field(default_factory=list)
    _free_at: float = 0.0

    def receive(self, now: float, data: bytes, baud: int | None = None) -> None:
        self._buffer += data
        arrived = now + wire_seconds(len(data), baud or 9600)
        while (body := cut_frame(self._buffer)) is not None:
            for unit in self.units:
                reply = unit.respond(body)
                unit.note(arrived)
                if reply is not None:
                    self._free_at = max(self._free_at, arrived) + wire_seconds(len(reply), baud or 9600)
                    self._sent.append((self._free_at, reply))

    def advance(self, now: float) -> bytes:
        due = [reply for at, reply in self._sent if at <= now]
        self._sent = [(at, reply) for at, reply in self._sent if at > now]
        return b"".join(due)

    def wake(self) -> Wake:
        return Wake(min((at for at, _ in self._sent), default=inf), sharp=False)

    def unplug(self) -> None:
        self._sent.clear()


def play(scene: Callable[[VirtualLine], Awaitable[None]], units: int = UNITS) -> None:
    """Run a scene with keypads on a virtual clock, once all that is needed was read."""
    keypads = Keypads([KeypadUnit(address) for address in range(1, units + 1)])

    async def begin(line: VirtualLine) -> None:
        await line.until(lambda: all(known(line, unit, SCALE) for unit in line.units))
        await scene(line)

    run(begin, units, configured=units, line=cast("SimulatedLine", keypads))


def drives(line: VirtualLine) -> list[KeypadUnit]:
    """The units, by their place on the cable."""
    return cast("Keypads", line.line).units


at_keypads = partial(played, UNITS, play=play)


def known(line: VirtualLine, unit: int, numbers: tuple[int, ...]) -> UnitScale:
    """What the worker has reported last; empty where one is missing."""
    values = line.raws[unit]
    return {number: values[number] for number in numbers} if values.keys() >= set(numbers) else {}


def converted(text: str, scale: UnitScale) -> int:
    """As the app converts what was typed."""
    if is_follower(scale[FOLLOWER_MODE]):
        return ratio_raw(text)
    return speed_raw(text, scale[DECIMALS] or 0)


@dataclass(frozen=True)
class Change:
    """Somebody at the keypad of a unit: after how many seconds, which parameter, to what; or a fault of the
    unit, which carries out a command without a response (MUTE) or acknowledges it without (DEAF)."""

    after_s: float
    unit: int
    number: int
    raw: int


@dataclass(frozen=True)
class Typed:
    """What a person enters, with what happens at the keypads meanwhile."""

    kind: str
    unit: int
    text: str
    changes: list[Change]
    wait_s: float


MUTE, DEAF = 0, -1
FAULTS = [(MUTE, 0), (MUTE, 0x81), (MUTE, 0x84), (MUTE, 0x85), (MUTE, 0x82), (DEAF, 0x84), (DEAF, 0x83)]
CHANGES = st.builds(
    lambda after_s, unit, what: Change(after_s, unit, *what),
    st.floats(0.0, 0.3),
    st.integers(1, UNITS),
    st.sampled_from(
        [(3, 0), (3, 1), (3, 2), (8, 0), (8, 1), (2, 2000), (2, 20000), (2, 99999), (6, 77), *FAULTS]
    ),
)
TYPED = st.builds(
    Typed,
    st.sampled_from(["set", "stage and execute", "stage and execute all", "group", "tolerance"]),
    st.integers(1, UNITS),
    st.sampled_from(["12", "100", "10.0", "55.5", "1.25", "0.5", "9"]),
    st.lists(CHANGES, max_size=4),
    st.floats(0.0, 1.5),
)


@dataclass
class Judge:
    """Enters what people type, and states what was *verified* beside another display."""

    line: VirtualLine
    complaints: list[str] = field(default_factory=list)
    outcomes: list[str] = field(default_factory=list)

    async def enter(self, typed: Typed) -> None:
        for change in typed.changes:
            self.line.loop.call_later(change.after_s, self._press, change)
        await asyncio.sleep(typed.wait_s / 10)
        try:
            await self._enter(typed)
        except CallerError:
            self.outcomes.append("not converted")
        await asyncio.sleep(typed.wait_s)
        for unit in drives(self.line):
            unit.mute_on.clear()
            unit.deaf_to.clear()

    def _press(self, change: Change) -> None:
        unit = drives(self.line)[change.unit - 1]
        if change.raw == 0 and change.number == MUTE:
            unit.mute_on.clear()
            unit.deaf_to.clear()
        elif change.number in (MUTE, DEAF):
            (unit.deaf_to if change.number == DEAF else unit.mute_on).add(change.raw)
        else:
            unit.values[change.number] = change.raw
        unit.note(self.line.loop.time())

    async def _enter(self, typed: Typed) -> None:
        unit, text = typed.unit, typed.text
        scale = known(self.line, unit, SCALE)
        match typed.kind:
            case "set":
                await self._perform(SetSpeed(unit, converted(text, scale)), {unit: scale}, {unit: text})
            case "group":
                scales = {each: known(self.line, each, SCALE) for each in self.line.units}
                raws = {each: converted(text, scales[each]) for each in scales}
                await self._perform(SetLine(raws), scales, dict.fromkeys(scales, text))
            case "tolerance":
                raw = converted(text, scale)
                if raw < 256 and not is_follower(scale[FOLLOWER_MODE]):
                    action = WriteParameter(unit, AT_SPEED_WINDOW, raw)
                    await self._perform(action, {unit: {DECIMALS: scale[DECIMALS]}}, {unit: text})
            case _:
                action = SetSpeed(unit, converted(text, scale), execute=False)
                staged = await self._perform(action, {unit: scale}, {})
                if staged.outcome == "acknowledged":
                    await asyncio.sleep(typed.wait_s / 5)
                    execute = ExecuteAll() if typed.kind.endswith("all") else ExecuteSpeed(unit)
                    await self._perform(execute, None, {unit: text})

    async def _perform(
        self, action: Action, scales: dict[int, UnitScale] | None, texts: dict[int, str]
    ) -> Result:
        began = self.line.loop.time()
        before = {unit.address: unit.commanded for unit in drives(self.line)}
        result = await self.line.perform(action, typed_with=scales)
        self.outcomes.append(result.outcome)
        verified = {part.unit for part in result.units if part.outcome == "verified"}
        for number, text in texts.items():
            unit = drives(self.line)[number - 1]
            is_setpoint = not isinstance(action, WriteParameter)
            history = unit.shown if is_setpoint else unit.tolerances
            shows = [shown for at, shown in history if at >= began]
            if number in verified and not any(float(shown) == float(text) for shown in shows):
                self.complaints.append(f"verified {text} at unit {number}, which showed {shows[-3:]}")
            if result.outcome == "refused" and is_setpoint and unit.commanded != before[number]:
                self.complaints.append(f"refused, and unit {number} was changed to {unit.commanded}")
        return result


@pytest.mark.parametrize("examples", sizes(10, 600))
def test_verified_never_stands_beside_a_number_that_the_display_does_not_show(examples: int) -> None:
    seen: list[str] = []

    @settings(
        max_examples=examples,
        deadline=None,
        phases=(Phase.explicit, Phase.reuse, Phase.generate),
        suppress_health_check=[HealthCheck.too_slow],
    )
    @given(st.lists(TYPED, min_size=4, max_size=12))
    def enter_all(people: list[Typed]) -> None:
        async def scene(line: VirtualLine) -> None:
            judge = Judge(line)
            for typed in people:
                await judge.enter(typed)
            seen.extend(judge.outcomes)
            assert judge.complaints == []

        play(scene)

    enter_all()
    assert seen.count("verified") > examples
    assert seen.count("refused") > examples / 5


async def result_of(line: VirtualLine, text: str, *pressed: Change, execute: bool = True) -> Result:
    scale = known(line, 1, SCALE)
    for change in pressed:
        drives(line)[change.unit - 1].values[change.number] = change.raw
    return await line.perform(SetSpeed(1, converted(text, scale), execute), typed_with={1: scale})


@at_keypads()
async def test_ten_times_what_was_typed_is_refused_with_old_and_new(line: VirtualLine) -> None:
    pressed = [Change(0, 1, DECIMALS, 0), Change(0, 1, MAX_DISPLAY, 2000)]
    result = await result_of(line, "100.0", *pressed)
    assert (result.outcome, result.unit_error) == ("refused", None)
    assert "(parameter 2) was 20000 and is 2000 now" in str(result.message)
    assert "(parameter 3) was 1 and is 0 now" in str(result.message)
    assert drives(line)[0].commanded == 500
    assert drives(line)[0].writes == []
    # What was read is reported: the next one is converted with it, and executed as it is shown.
    result = await result_of(line, "100")
    assert (result.outcome, drives(line)[0].display(drives(line)[0].commanded)) == ("verified", "100")


@at_keypads()
async def test_a_scale_that_changes_between_the_write_and_its_read_back_leaves_it_unverified(
    line: VirtualLine,
) -> None:
    unit = drives(line)[0]
    scale = known(line, 1, SCALE)
    command = line.command(SetSpeed(1, 1000), typed_with={1: scale})
    await line.until(lambda: unit.commanded == 1000)
    unit.values[DECIMALS] = 0
    await line.until(lambda: line.result_of(command))
    result = line.result_of(command)
    assert result is not None
    assert result.outcome == "unverified"
    assert "another scale" in str(result.message)


@at_keypads()
async def test_a_group_stops_before_the_unit_whose_scale_is_another(line: VirtualLine) -> None:
    scales = {unit: known(line, unit, SCALE) for unit in line.units}
    drives(line)[2].values[DECIMALS] = 0
    result = await line.perform(SetLine(dict.fromkeys(line.units, 900)), typed_with=scales)
    assert result.outcome == "refused"
    assert [unit.commanded for unit in drives(line)] == [500] * UNITS
    assert not any(command == 0x83 for unit in drives(line) for command, _, _ in unit.writes)
    assert [unit.staged for unit in drives(line)] == [None] * UNITS, "all scales before any stage"


@at_keypads()
async def test_a_unit_whose_scale_cannot_be_read_is_not_said_to_hold_what_was_never_sent(
    line: VirtualLine,
) -> None:
    scales = {unit: known(line, unit, SCALE) for unit in line.units}
    drives(line)[0].mute_on |= {0x85}
    result = await line.perform(SetLine(dict.fromkeys(line.units, 900)), typed_with=scales)
    assert str(result.message) == f"unit {line.units[0]} did not respond; no unit was changed"
    assert str(result.units[0].message) == f"unit {line.units[0]} did not respond; nothing was sent"
    assert [unit.staged for unit in drives(line)] == [None] * UNITS


@played(24, play=play)
async def test_a_typed_group_of_24_units_is_executed_within_the_two_seconds_of_a_command(
    line: VirtualLine,
) -> None:
    """At 9600 baud; the line's clock is virtual."""
    scales = {unit: known(line, unit, SCALE) for unit in line.units}
    result = await line.perform(SetLine(dict.fromkeys(line.units, 900)), timeout_s=2.0, typed_with=scales)
    assert (result.outcome, {unit.outcome for unit in result.units}) == ("verified", {"verified"})


@at_keypads()
async def test_what_was_given_raw_is_sent_before_any_scale_is_read(line: VirtualLine) -> None:
    drives(line)[0].values[DECIMALS] = 0
    result = await line.perform(SetSpeed(1, 900))
    assert (result.outcome, result.read_back) == ("verified", 900)


@pytest.mark.parametrize("mode", [0, 1], ids=["master", "follower"])
@at_keypads()
async def test_the_scale_of_a_raw_speed_costs_one_read_unless_the_status_shows_another_mode(
    line: VirtualLine, mode: int
) -> None:
    drives(line)[0].values |= {FOLLOWER_MODE: mode, DECIMALS: 2}
    deadline = EPOCH + line.loop.time() + 2.0
    line.worker.command(Command("raw", deadline, SetSpeed(1, 900), {1: {FOLLOWER_MODE: 0, DECIMALS: 1}}))
    await line.until(lambda: line.result_of("raw"))
    result = line.result_of("raw")
    assert result is not None
    assert result.outcome == "verified"
    assert known(line, 1, (FOLLOWER_MODE, DECIMALS)) == {FOLLOWER_MODE: mode, DECIMALS: 2}
    sent = [frame.data[3] for frame in result.frames if frame.direction == "out"]
    assert sent == [0x84, 0x85, 0x81] or mode


@at_keypads()
async def test_a_speed_that_was_staged_in_another_scale_is_not_executed(line: VirtualLine) -> None:
    assert (await result_of(line, "70.0", execute=False)).outcome == "acknowledged"
    drives(line)[0].values[DECIMALS] = 0
    for action in (ExecuteSpeed(1), ExecuteAll()):
        result = await line.perform(action)
        assert (result.outcome, drives(line)[0].commanded) == ("refused", 500)


@at_keypads()
async def test_the_analog_output_is_bounded_and_converted_as_the_unit_does_now(line: VirtualLine) -> None:
    numbers = (ANALOG_OUT_SOURCE, ANALOG_OUT_LOW, ANALOG_OUT_HIGH)
    await line.until(lambda: known(line, 1, numbers))
    scale = {1: known(line, 1, numbers)}
    assert (await line.perform(WriteAnalogOutput(1, 350), typed_with=scale)).outcome == "acknowledged"
    drives(line)[0].values[ANALOG_OUT_HIGH] = 1000
    assert (await line.perform(WriteAnalogOutput(1, 360), typed_with=scale)).outcome == "refused"
    assert drives(line)[0].analog_out == 350


@at_keypads()
async def test_one_parameter_changed_at_the_keypad_has_the_scale_read_again_soon(line: VirtualLine) -> None:
    await asyncio.sleep(10.0)
    drives(line)[1].values |= {6: 77, DECIMALS: 3}
    await line.until(lambda: known(line, 2, (6,)) == {6: 77}, within_s=300.0)
    found_at = line.loop.time()
    await line.until(lambda: known(line, 2, (DECIMALS,)) == {DECIMALS: 3}, within_s=300.0)
    assert line.loop.time() - found_at < 3.0


@at_keypads()
async def test_what_a_unit_holds_staged_is_not_known_after_it_was_away_and_is_not_executed(
    line: VirtualLine,
) -> None:
    assert (await line.perform(SetSpeed(1, 700, execute=False))).outcome == "acknowledged"
    drives(line)[0].off = True
    await line.until(lambda: line.worker.line.roster[1].link.link == "offline")
    drives(line)[0].off, drives(line)[0].staged = False, 300
    await line.until(lambda: line.worker.line.roster[1].link.link == "online")
    reported = [update for update in line.updates if isinstance(update, Staged)]
    assert reported[-1] == Staged(1, reported[-1].at, None, unknown=True)
    assert reported[-1].at > EPOCH
    for action in (ExecuteSpeed(1), ExecuteAll()):
        result = await line.perform(action)
        assert (result.outcome, drives(line)[0].commanded) == ("refused", 500)
    result = await line.perform(SetLine({2: 600, 3: 600}))
    assert (result.outcome, drives(line)[0].commanded) == ("verified", 500)
    assert not line.worker.line.roster[1].staged_unknown, "its present speed was staged instead"


@at_keypads()
async def test_what_an_earlier_worker_staged_is_not_known_and_moves_with_no_other(line: VirtualLine) -> None:
    first, roster = drives(line)[0], line.worker.line.roster
    first.staged = 300
    line.worker.note_held([1, 99])
    assert line.worker.snapshot(0).units[0].staged_unknown
    for action in (ExecuteSpeed(1), ExecuteAll()):
        assert ((await line.perform(action)).outcome, first.commanded) == ("refused", 500)
    result = await line.perform(SetLine({2: 800, 3: 800}))
    assert (result.outcome, first.commanded) == ("verified", 500)
    line.worker.note_held([2])
    assert not roster[1].staged_unknown, "its present speed was staged instead"
    assert not roster[2].staged_unknown, "a later app does not know better"


@at_keypads()
async def test_what_is_staged_in_a_unit_that_is_not_configured_any_more_moves_with_no_change(
    line: VirtualLine,
) -> None:
    removed, silent = KeypadUnit(UNITS + 1), UNITS + 2
    drives(line).append(removed)
    removed.staged = 300
    line.worker.note_held([removed.address, silent])
    result = await line.perform(SetLine({2: 800, 3: 800}))
    assert (result.outcome, removed.commanded) == ("verified", 500)
    line.worker.line.roster.note_held([removed.address], EPOCH)
    removed.staged = 300
    await line.perform(SetSpeed(1, 600, execute=False))
    assert ((await line.perform(ExecuteAll())).outcome, drives(line)[0].commanded) == ("verified", 600)
    assert removed.commanded == 500


@at_keypads()
async def test_what_82h_left_in_a_unit_without_a_response_is_not_known_and_moves_with_no_other(
    line: VirtualLine,
) -> None:
    """Never broadcast while a stage is unacknowledged (protocol, 5)."""
    first = drives(line)[0]
    assert (await line.perform(SetSpeed(1, 600, execute=False))).outcome == "acknowledged"
    first.mute_on.add(0x82)
    assert (await line.perform(SetSpeed(1, 700, execute=False))).outcome == "unverified"
    first.mute_on.clear()
    assert first.staged == 700
    assert line.worker.line.roster[1].staged_unknown
    for action in (ExecuteSpeed(1), ExecuteAll()):
        assert ((await line.perform(action)).outcome, first.commanded) == ("refused", 500)
    result = await line.perform(SetLine({2: 800, 3: 800}))
    assert (result.outcome, first.commanded) == ("verified", 500)


@at_keypads()
async def test_a_unit_that_is_away_does_not_keep_the_others_from_a_change_after_one_with_it_has_failed(
    line: VirtualLine,
) -> None:
    drives(line)[0].off = True
    await line.until(lambda: line.worker.line.roster[1].link.link == "offline")
    assert (await line.perform(SetLine({1: 800, 2: 800}))).outcome == "unverified"
    assert (await line.perform(SetLine({2: 800, 3: 800}))).outcome == "verified"


@pytest.mark.parametrize("action", [SetSpeed(1, 700), ExecuteSpeed(1)])
@at_keypads()
async def test_a_unit_that_shows_the_speed_holds_none_staged_although_its_response_was_lost(
    line: VirtualLine, action: SetSpeed | ExecuteSpeed
) -> None:
    assert (await line.perform(SetSpeed(1, 700, execute=False))).outcome == "acknowledged"
    drives(line)[0].mute_on |= {0x83, 0x84}
    assert (await line.perform(action)).outcome == "verified"
    assert line.worker.line.roster[1].staged is None


@at_keypads()
async def test_a_unit_that_missed_the_broadcast_and_has_another_scale_now_is_not_executed_by_itself(
    line: VirtualLine,
) -> None:
    first = drives(line)[0]
    respond = first.respond

    def misses_the_broadcast(body: bytes) -> bytes | None:
        if body == bytes([0, 0x83]):
            first.values[DECIMALS] = 0
            return None
        return respond(body)

    first.respond = misses_the_broadcast  # type: ignore[method-assign]
    scales = {unit: known(line, unit, SCALE) for unit in line.units}
    result = await line.perform(SetLine(dict.fromkeys(line.units, 900)), typed_with=scales)
    assert (result.outcome, first.commanded) == ("unverified", 500)
    assert {part.outcome for part in result.units if part.unit != 1} == {"verified"}
