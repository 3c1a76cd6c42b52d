"""Scans of units that take about as long to respond as they are allowed, on a virtual clock."""

from __future__ import annotations

import asyncio

import pytest

from bus.catalogue import parameters as numbers
from bus.contract import Result, ScanBus
from bus.line.examination import LATE, Found
from bus.line.scanner import BaudScan, ScanPort, scan_addresses
from bus.simulator.line import Faults, SimulatedLine
from bus.simulator.plant import Section, demo_line
from bus.simulator.unit import Memory, Traits, Unit
from tests.bus.virtual_line import VirtualClock, VirtualLine, VirtualPort, run, run_virtually
from tests.sizes import in_turn, sizes

ALLOWED_S = 0.050
"""The default of ``turnaround_ms``."""
USB_LATENCY_S = 0.016
"""An FTDI adapter without low latency delivers what it received every 16 ms."""
UNITS = 4
PORTS = ((300, 0.0), (9600, 0.0), (300, USB_LATENCY_S), (9600, USB_LATENCY_S))
"""The baud rate and the latency of an adapter."""
TURNAROUNDS_S = [0.001, 0.045, 0.048, 0.050, 0.055, 0.060, 0.100, 0.400]


class AdapterPort(VirtualPort):
    """Delivers bytes every ``latency_s`` seconds, or at once."""

    latency_s = 0.0
    _timer: asyncio.TimerHandle | None = None

    def _hand_over(self) -> None:
        if not self.latency_s:
            super()._hand_over()
        elif self._gathered and self._timer is None:
            ticks = int(self._loop.time() / self.latency_s) + 1
            self._timer = self._loop.call_at(ticks * self.latency_s, self._tick)

    def _tick(self) -> None:
        self._timer = None
        super()._hand_over()


async def scan(
    turnaround_s: float, baud: int, latency_s: float, *extra: Unit, units: int = UNITS
) -> BaudScan:
    """A scan of simulated units that allows each ``ALLOWED_S``."""
    loop = asyncio.get_running_loop()
    plant = demo_line(units, seed=1, traits=Traits(turnaround_s=turnaround_s), script=False).plant
    plant.sections += [Section(unit) for unit in extra]
    for unit in plant.units:
        unit.memory[numbers.BAUD_RATE] = baud // 100
        unit.power_up()
    line = ScanPort(baud, VirtualClock(loop))
    port = AdapterPort(SimulatedLine(plant, Faults(1), baud), line, loop, baud)
    port.latency_s = latency_s
    port.start()
    line.attach(port)
    result = BaudScan(baud, ALLOWED_S)
    await scan_addresses(result, line, range(1, units + 2), lambda _settled: None)
    return result


def kinds(found: list[Found]) -> dict[int, str]:
    return {one.unit: one.kind for one in found}


@pytest.mark.parametrize(("turnaround_s", "port"), in_turn(TURNAROUNDS_S, PORTS))
def test_slow_units_are_not_taken_for_two_at_one_address(
    turnaround_s: float, port: tuple[int, float]
) -> None:
    baud, latency_s = port
    result = run_virtually(scan(turnaround_s, baud, latency_s))
    assert kinds(result.found) == dict.fromkeys(range(1, UNITS + 1), "digimax")
    assert [one.remarks for one in result.found] == [()] * UNITS
    assert result.turnaround_s >= min(turnaround_s, 1.0)


@pytest.mark.parametrize("turnaround_s", [0.001, 0.048, 0.100])
@pytest.mark.parametrize("baud", [1200, 9600])
def test_two_units_at_one_address_are_still_recognized(turnaround_s: float, baud: int) -> None:
    twin = Unit(
        Memory({numbers.OWN_ADDRESS: 2, numbers.BAUD_RATE: baud // 100}), Traits(turnaround_s=turnaround_s)
    )
    result = run_virtually(scan(turnaround_s, baud, 0.0, twin))
    assert kinds(result.found) == {1: "digimax", 2: "garbled", 3: "digimax", 4: "digimax"}


def test_a_quick_unit_needs_no_longer_turnaround() -> None:
    assert run_virtually(scan(0.001, 9600, 0.0)).turnaround_s == ALLOWED_S


def bus_scan(turnaround_s: float) -> Result:
    """A scan by the worker of a bus that allows each unit ``ALLOWED_S``."""

    async def scene(line: VirtualLine) -> Result:
        for unit in line.plant.units:
            unit.traits = Traits(turnaround_s=turnaround_s)
        await asyncio.sleep(2.0)
        return await line.perform(ScanBus(1, UNITS + 1), within_s=600.0)

    return run(scene, UNITS)


@pytest.mark.parametrize("turnaround_s", [*sizes(0.001, *TURNAROUNDS_S[1:-3], 0.1), 0.055, 0.4])
def test_a_bus_at_work_takes_no_slow_unit_for_two(turnaround_s: float) -> None:
    result = bus_scan(turnaround_s)
    assert "garbled" not in [found.kind for found in result.found]


def test_a_bus_at_work_names_units_that_are_slower_than_allowed() -> None:
    result = bus_scan(0.080)
    assert result.message == LATE
    assert {found.kind for found in result.found} <= {"digimax", "late"}
    assert {found.unit for found in result.found} >= set(range(1, UNITS + 1))
