"""The worker over long times on a virtual clock: deadlines under every fault, equal shares, equal bytes."""

from __future__ import annotations

import asyncio
import random

import pytest

from bus.contract import SetSpeed
from bus.simulator.line import FaultKind
from tests.bus.virtual_line import VirtualLine, run
from tests.sizes import sizes

UNITS = 4
RATE = 0.05
BLOCKING = (FaultKind.ALL_ADDRESSES, FaultKind.HUGE, FaultKind.FLOOD)
"""Each of these blocks all traffic on the line."""
SET_AND_EXECUTE = 0x84


def spoil(line: VirtualLine) -> None:
    for kind in FaultKind:
        if kind not in BLOCKING:
            line.faults.set(kind, RATE)


def writes(data: bytes) -> bool:
    """Whether a frame as on the wire is an 84h (unit 16 is sent as 10 10)."""
    return SET_AND_EXECUTE in data[3:5]


def test_writes_leave_before_their_deadline_or_not_at_all() -> None:
    async def scene(line: VirtualLine) -> None:
        spoil(line)
        await asyncio.sleep(1.0)
        draw = random.Random(5)
        for _ in range(40):
            unit, raw = draw.randint(1, UNITS), draw.randint(0, 1500)
            given = draw.choice((0.0, 0.02, 0.1, 0.4))
            began, number = line.loop.time(), len(line.written)
            await line.perform(SetSpeed(unit, raw), timeout_s=given)
            late = [at for at, data in line.written[number:] if writes(data) and at > began + given + 1e-9]
            assert not late

    run(scene, UNITS)


def test_the_same_seed_gives_the_same_bytes() -> None:
    async def scene(line: VirtualLine) -> list[tuple[float, bytes]]:
        spoil(line)
        await asyncio.sleep(1.0)
        draw = random.Random(4)
        for _ in range(20):
            await line.perform(SetSpeed(draw.randint(1, UNITS), draw.randint(0, 1500)))
        return line.written

    first = run(scene, UNITS, seed=9)
    assert len(first) > 100
    assert run(scene, UNITS, seed=9) == first
    assert run(scene, UNITS, seed=10) != first


@pytest.mark.parametrize(("units", "minutes", "read"), sizes((2, 0.5, 20), (8, 10, 320)))
def test_minutes_without_a_fault_report_every_unit_alike(units: int, minutes: float, read: int) -> None:
    """``read``: how many parameters beside the scan, in ten minutes all of them."""
    seconds = 60 * minutes

    async def scene(line: VirtualLine) -> None:
        await asyncio.sleep(seconds)
        counts = [len(line.readings(unit)) for unit in line.units]
        assert max(counts) - min(counts) <= 3, "but for the 81h that fences a parameter"
        assert sum(counts) / seconds > 37.0
        assert len({(value.unit, value.number) for value in line.parameters()}) >= read

    run(scene, units)
