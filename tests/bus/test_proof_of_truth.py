"""The fault matrix: every fault alone and all at once, hundreds of writes, and nothing but the truth.

Judged by the simulated line's own record: nothing told that no unit said, nothing verified that is not so,
nothing carried out that was not asked for, nothing sent after its time.
"""

from __future__ import annotations

import asyncio
import random

import pytest

from bus.contract import (
    Action,
    ExecuteSpeed,
    Result,
    SetLine,
    SetSpeed,
    WriteOutput,
    WriteParameter,
)
from bus.line.staging import ALL_UNITS
from bus.simulator.faults import Kind
from bus.simulator.record import Happened
from bus.wire.commands import is_request
from bus.wire.framing import FrameDecoder, ReceivedFrame
from tests.bus.judge import made_up
from tests.bus.virtual_line import EPOCH, VirtualLine, run

UNITS = 4
RATE = 0.05
ALONE = [kind for kind in Kind if kind is not Kind.FLOOD]
TOGETHER = [kind for kind in ALONE if kind not in (Kind.EVERYBODY, Kind.HUGE)]
"""Not the two that block the whole line by themselves: an answer of 10,000 bytes takes ten seconds."""


def random_action(draw: random.Random) -> Action:
    unit = draw.randint(1, UNITS)
    return draw.choice(
        [
            SetSpeed(unit, draw.randint(0, 1500)),
            SetSpeed(unit, draw.randint(0, 1500), execute=False),
            ExecuteSpeed(unit),
            WriteOutput(unit, draw.randint(1, 6), draw.random() < 0.5),
            WriteParameter(unit, draw.choice((6, 7)), draw.randint(0, 9999)),
            SetLine({each: draw.randint(0, 1500) for each in range(1, UNITS + 1)}),
        ]
    )


async def write_at_random(line: VirtualLine, count: int, seed: int) -> list[tuple[Action, Result]]:
    """``count`` commands one after the other, each judged as soon as its fate is known."""
    draw = random.Random(seed)
    done = []
    await asyncio.sleep(1.0)
    for _ in range(count):
        action = random_action(draw)
        number = line.line.record.count
        fate = await line.ask(action, timeout_s=draw.choice((0.05, 0.3, 2.0)))
        judge(line, action, fate, number)
        done.append((action, fate))
    return done


def judge(line: VirtualLine, action: Action, fate: Result, since: int) -> None:
    """Hold ``fate`` against the plant as it is at this very moment."""
    acted = [(e.unit, e.data) for e in line.line.record.since(since, Happened.ACTED)]
    if fate.outcome in ("not_sent", "bus_closed", "invalid") and not isinstance(action, SetLine):
        assert not acted, f"{action}: said {fate.outcome}, but {acted}"
    if isinstance(action, SetLine):
        broadcast = any(data[0] == ALL_UNITS for _, data in acted)
        assert fate.outcome == "verified" or not broadcast or fate.outcome == "unverified"
    if fate.outcome != "verified":
        return
    match action:
        case SetSpeed(unit=unit, raw=raw, execute=True):
            assert line.plant.unit(unit).setpoint == raw
        case WriteOutput(unit=unit, number=number, on=on):
            assert line.plant.unit(unit).outputs[number - 1] == on
        case WriteParameter(unit=unit, number=number, raw=raw):
            assert line.plant.unit(unit).memory[number] == raw
        case SetLine(setpoints=setpoints):
            for unit, raw in setpoints.items():
                assert line.plant.unit(unit).setpoint == raw


def asked_for(line: VirtualLine, done: list[tuple[Action, Result]]) -> None:
    """Every write a unit carried out was one of ours, or put back what the unit had."""
    speeds = {raw for action, _ in done for raw in _speeds(action)}
    present = {reading.commanded for reading in line.readings()}
    for _, unit, data in line.acted():
        if data[1] == 0x84:
            assert int.from_bytes(data[2:], "big") in speeds, (unit, data)
        if data[1] == 0x82:
            assert int.from_bytes(data[2:], "big") in speeds | present, (unit, data)


def _speeds(action: Action) -> set[int]:
    if isinstance(action, SetSpeed):
        return {action.raw}
    return set(action.setpoints.values()) if isinstance(action, SetLine) else set()


def writing_frames(line: VirtualLine) -> list[tuple[float, bytes]]:
    """When each frame that writes left, and what it carried."""
    frames = []
    for at, data in line.written:
        for event in FrameDecoder(line.bus.dialect).feed(data):
            assert isinstance(event, ReceivedFrame), data
            assert is_request(event.body)
            if event.body[1] not in (0x81, 0x85):
                frames.append((at, event.body))
    return frames


def play(kinds: list[Kind], count: int, seed: int) -> list[tuple[Action, Result]]:
    async def scene(line: VirtualLine) -> list[tuple[Action, Result]]:
        for kind in kinds:
            line.faults.set(kind, RATE)
        done = await write_at_random(line, count, seed)
        assert not made_up(line.updates, line.line.record, EPOCH)
        asked_for(line, done)
        return done

    return run(scene, UNITS, seed=seed)


@pytest.mark.parametrize("kind", ALONE, ids=str)
def test_each_fault_alone(kind: Kind) -> None:
    done = play([kind], 60, seed=11)
    outcomes = {fate.outcome for _, fate in done}
    assert "verified" in outcomes


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_all_faults_together(seed: int) -> None:
    done = play(TOGETHER, 150, seed)
    assert sum(fate.outcome == "verified" for _, fate in done) > 20


def test_writes_leave_before_their_deadline_or_not_at_all() -> None:
    async def scene(line: VirtualLine) -> None:
        for kind in TOGETHER:
            line.faults.set(kind, RATE)
        await asyncio.sleep(1.0)
        draw = random.Random(5)
        for _ in range(150):
            unit, raw, given = (
                draw.randint(1, UNITS),
                draw.randint(0, 1500),
                draw.choice((0.0, 0.02, 0.1, 0.4)),
            )
            began, number = asyncio.get_running_loop().time(), len(line.written)
            await line.ask(SetSpeed(unit, raw), timeout_s=given)
            for at, data in line.written[number:]:
                if data[3] == 0x84 or data[4] == 0x84:
                    assert at <= began + given + 1e-9

    run(scene, UNITS)


def test_the_same_seed_gives_the_same_bytes() -> None:
    async def scene(line: VirtualLine) -> list[tuple[float, bytes]]:
        for kind in TOGETHER:
            line.faults.set(kind, RATE)
        await write_at_random(line, 30, seed=4)
        return line.written

    assert run(scene, UNITS, seed=9) == run(scene, UNITS, seed=9)


def test_ten_minutes_without_a_fault_tell_every_unit_alike() -> None:
    async def scene(line: VirtualLine) -> None:
        await asyncio.sleep(600)
        counts = [len(line.readings(unit)) for unit in range(1, 9)]
        assert max(counts) - min(counts) <= 1
        assert sum(counts) / 600 > 37.0
        assert len({(value.unit, value.number) for value in line.parameters()}) == 8 * 40

    run(scene, 8)
