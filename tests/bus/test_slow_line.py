"""Commands on a slow line, where one poll takes longer than commands may keep the schedule waiting."""

from __future__ import annotations

import pytest

from bus.catalogue.parameters import BAUD_RATE
from bus.contract import Action, ReadParameters, SetLine, SetSpeed
from bus.contract.actions import POLL_BYTES
from bus.line.arbiter import COMMANDS_AT_A_STRETCH_S
from bus.settings import BAUDS, wire_seconds
from tests.bus.virtual_line import VirtualLine, run

UNITS = 4


async def all_online(line: VirtualLine, baud: int) -> None:
    """The units have the baud rate of the port, and each has been read."""
    for unit in line.units:
        line.plant.unit(unit).memory[BAUD_RATE] = baud // 100
        line.plant.unit(unit).baud = baud
    await line.until(lambda: {each.unit for each in line.readings()} == set(line.units))


def test_a_poll_of_the_slowest_line_takes_longer_than_commands_may() -> None:
    assert wire_seconds(POLL_BYTES, min(BAUDS)) > COMMANDS_AT_A_STRETCH_S


@pytest.mark.parametrize("baud", BAUDS)
@pytest.mark.parametrize(
    "action",
    [
        SetSpeed(unit=1, raw=640),
        ReadParameters(unit=2, numbers=[8, 2]),
        SetLine(setpoints={1: 640, 2: 650, 3: 660, 4: 670}),
    ],
    ids=lambda action: type(action).__name__,
)
def test_a_command_has_its_turn_at_every_baud(baud: int, action: Action) -> None:
    async def scene(line: VirtualLine) -> None:
        await all_online(line, baud)
        result = await line.perform(action, timeout_s=20.0)
        assert result.outcome == "verified", str(result.message)

    run(scene, UNITS, baud=baud)


def test_polls_go_on_while_commands_wait() -> None:
    async def scene(line: VirtualLine) -> None:
        await all_online(line, min(BAUDS))
        seen = len(line.readings())
        commands = [
            line.command(ReadParameters(unit=unit, numbers=[2, 6, 7, 8]), timeout_s=60.0)
            for unit in line.units
        ]
        await line.until(lambda: all(map(line.result_of, commands)))
        assert len(line.readings()) - seen >= 4 * UNITS - 1

    run(scene, UNITS, baud=min(BAUDS))
