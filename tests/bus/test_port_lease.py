"""A worker of a leased home: its port is open while that is confirmed, and nothing is written after it."""

from __future__ import annotations

import asyncio
import math

from bus.contract import BusLink, SetSpeed
from bus.instants import Monotonic
from bus.line.port_lease import NO_LEASE, NOT_CONFIRMED, PortLease
from tests.bus.virtual_line import VirtualLine, run


def extend(line: VirtualLine, left_s: float) -> None:
    line.lease.extend(line.lease.clock(), left_s)


def test_without_a_lease_the_port_is_this_process_s_for_good() -> None:
    NO_LEASE.extend(Monotonic(0.0), 0.0)
    assert NO_LEASE.holds()
    assert NO_LEASE.left_s() == math.inf


def test_a_response_that_was_held_up_extends_nothing() -> None:
    now = [100.0]
    lease = PortLease(is_needed=True, clock=lambda: Monotonic(now[0]))
    assert not lease.holds(), "before the first confirmation"
    lease.extend(Monotonic(100.0), 4.0)
    assert lease.left_s() == 4.0
    now[0] = 110.0
    lease.extend(Monotonic(104.0), 4.0)
    assert not lease.holds(), "requested at 104, it ended at 108"
    lease.extend(Monotonic(110.0), 4.0)
    lease.extend(Monotonic(110.0), 0.0)
    assert not lease.holds(), "the home was given up"


def test_the_port_opens_with_the_lease_and_closes_with_it() -> None:
    async def scene(line: VirtualLine) -> None:
        await asyncio.sleep(2.0)
        assert line.written == [], "nothing before the first confirmation"
        extend(line, 4.0)
        await line.until(lambda: line.readings(1))
        await asyncio.sleep(6.0)
        last = line.written[-1][0]
        assert last < 6.1, "4 s from the confirmation at 2 s, polled to the end"
        links = [update for update in line.updates if isinstance(update, BusLink)]
        assert (links[-1].link, links[-1].cause) == ("closed", NOT_CONFIRMED)
        extend(line, 4.0)
        await line.until(lambda: line.written[-1][0] > last)

    run(scene, 2, leased=True)


def test_a_process_that_stood_still_writes_nothing_more() -> None:
    """Stopped in the middle of polling and of a command; the clock of its line went on, too."""

    async def scene(line: VirtualLine) -> None:
        extend(line, 4.0)
        await line.until(lambda: line.readings(2))
        await asyncio.sleep(0.5)
        line.suspended_s = 10.0
        count = len(line.written)
        command = line.command(SetSpeed(1, 640), timeout_s=30.0)
        await asyncio.sleep(3.0)
        assert len(line.written) == count, "not one byte"
        assert line.acted() == []
        result = line.result_of(command)
        assert result is not None
        assert result.outcome in ("not_sent", "bus_closed")

    run(scene, 2, leased=True)


def test_a_command_of_a_former_home_is_not_sent() -> None:
    async def scene(line: VirtualLine) -> None:
        await line.until(lambda: line.readings(2))
        assert line.worker.welcomed(7)
        assert line.worker.hello().epoch == 7
        former = line.command(SetSpeed(1, 640), epoch=6)
        await line.until(lambda: line.result_of(former))
        result = line.result_of(former)
        assert result is not None
        assert (result.outcome, result.message.code if result.message else "") == (
            "not_sent",
            "command_of_former_home",
        )
        present = line.command(SetSpeed(1, 641), epoch=7)
        await line.until(lambda: line.result_of(present))
        assert line.plant.unit(1).setpoint == 641
        later = line.command(SetSpeed(1, 642), epoch=9)
        await line.until(lambda: line.result_of(later))
        assert not line.worker.welcomed(8), "it has seen a higher one by a command"

    run(scene, 2)
