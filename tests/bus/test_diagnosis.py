"""A second host on the wire, and commands on a line where one poll takes long."""

from __future__ import annotations

import asyncio

import pytest

from bus.catalogue.parameters import BAUD_RATE
from bus.contract import Action, BusFigures, ReadParameters, SetLine, SetSpeed, UnitFigures
from bus.contract.actions import POLL_BYTES
from bus.instants import Monotonic
from bus.line.arbiter import COMMANDS_AT_A_STRETCH_S
from bus.line.diagnosis import CLEAR_AFTER_S, LATE_WITHIN_S, MAX_OUTSTANDING, SecondMaster
from bus.settings import BAUDS, Dialect, wire_seconds
from bus.wire.framing import encode_frame
from tests.bus.virtual_line import VirtualLine, played, run

RESPONSE = bytes((2, 0x81, 0x06, *(0,) * 10))
"""Of unit 2, as far as the address goes."""


def test_three_within_two_seconds_are_another_host_and_ten_seconds_without_are_its_end() -> None:
    host = SecondMaster()
    for at in (0.0, 1.5, 3.1):
        host.note(Monotonic(at))
    assert not host.is_present(Monotonic(3.1)), "too seldom"
    host.note(Monotonic(3.2))
    assert host.is_present(Monotonic(3.2))
    host.note(Monotonic(9.0))
    assert host.is_present(Monotonic(9.0 + CLEAR_AFTER_S - 0.1))
    assert not host.is_present(Monotonic(9.0 + CLEAR_AFTER_S))


def test_a_few_timeouts_of_many_requests_are_no_fault() -> None:
    figures = UnitFigures(unit=1, responses=970, timeouts=30)
    assert not figures.is_fault(figures.timeouts)
    assert figures.is_fault(101)
    assert not UnitFigures(unit=1, responses=1, timeouts=1).is_fault(1)


def test_a_request_explains_one_response() -> None:
    host, now = SecondMaster(), Monotonic(9.0)
    assert not host.explains(2, now)
    for _ in range(2):
        host.requested(2, now)
    host.responded(2)
    assert not host.explains(3, now)
    assert host.explains(2, now), "the late response to the first"
    assert not host.explains(2, now), "one response too many"
    for _ in range(100):
        host.requested(2, now)
    assert sum(host.explains(2, now) for _ in range(100)) == MAX_OUTSTANDING, "it was off"


def test_a_response_to_a_request_of_long_ago_is_one_to_another_host() -> None:
    host = SecondMaster()
    for at in (0.0, 30.0):
        host.requested(2, Monotonic(at))
    host.requested(2, Monotonic(31.0))
    host.responded(2)
    assert host.explains(2, Monotonic(30.0 + LATE_WITHIN_S)), "the second"
    assert not host.explains(2, Monotonic(30.0 + LATE_WITHIN_S)), "the first"


async def respond_to_another(line: VirtualLine) -> None:
    """Units respond to another host for a second, beside our polls and not in the middle of a response."""
    frame = encode_frame(RESPONSE, Dialect())
    for _ in range(10):
        sent = len(line.written)
        await line.until(lambda: len(line.written) > sent)  # noqa: B023
        assert line.port is not None
        line.worker.line.link.data_received(frame)
        await asyncio.sleep(0.1)


@played(3)
async def test_writing_stops_within_two_seconds_but_for_a_stop_and_is_reported(line: VirtualLine) -> None:
    await line.until(lambda: all(line.readings(unit) for unit in line.units))
    assert (await line.perform(SetSpeed(1, 640))).outcome == "verified"
    await respond_to_another(line)
    refused = await line.perform(SetSpeed(1, 650))
    assert refused.outcome == "not_sent"
    assert refused.message is not None
    assert refused.message.code == "second_master_writes"
    assert (await line.perform(SetLine({1: 0, 3: 5}))).outcome == "not_sent"
    assert line.plant.unit(1).setpoint == 640
    assert (await line.perform(SetSpeed(1, 0))).outcome == "verified", "a stop is written"
    figures = [update for update in line.updates if isinstance(update, BusFigures)]
    assert any(each.has_second_master for each in figures)
    assert figures[-1].unrequested > 0
    await asyncio.sleep(CLEAR_AFTER_S + 1.0)
    assert (await line.perform(SetSpeed(1, 650))).outcome == "verified"


UNITS = 4


async def all_online(line: VirtualLine, baud: int) -> None:
    """The units have the baud rate of the port, and each has been read."""
    for unit in line.units:
        line.plant.unit(unit).memory[BAUD_RATE] = baud // 100
        line.plant.unit(unit).baud = baud
    await line.until(lambda: {each.unit for each in line.readings()} == set(line.units))


def test_a_poll_of_the_slowest_line_takes_longer_than_commands_may() -> None:
    assert wire_seconds(POLL_BYTES, min(BAUDS)) > COMMANDS_AT_A_STRETCH_S


@pytest.mark.parametrize("baud", [min(BAUDS), max(BAUDS)])
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
