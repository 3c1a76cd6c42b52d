"""A worker's scan of addresses in the gaps of its round, on a virtual clock."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from functools import cache

from bus.contract import FoundUnit, ParameterValue, Progress, Reading, Result, ScanBus, UnitLink
from bus.simulator.line import FaultKind
from tests.bus.virtual_line import VirtualLine, run

CONFIGURED, PRESENT = 3, 5


def kinds(result: Result) -> dict[int, str]:
    return {found.unit: found.kind for found in result.found}


async def scan(line: VirtualLine, last: int = 8) -> Result:
    await asyncio.sleep(2.0)
    return await line.perform(ScanBus(1, last), within_s=600.0)


@cache
def scanned() -> tuple[Result, VirtualLine]:
    """A scan beside the round of fewer units than there are, which several tests look at."""

    async def scene(line: VirtualLine) -> tuple[Result, VirtualLine]:
        return await scan(line), line

    return run(scene, PRESENT, configured=CONFIGURED)


def test_it_finds_unconfigured_units() -> None:
    result, _ = scanned()
    assert result.outcome == "verified"
    assert result.found == [
        FoundUnit(unit, 9600, "digimax", list(range(1, 41)), []) for unit in range(1, PRESENT + 1)
    ]


def test_a_scan_teaches_no_parameter_that_there_is_not() -> None:
    """Its probes request numbers beyond the list, and the app rejects a message with one."""
    read = {update.number for update in scanned()[1].updates if isinstance(update, ParameterValue)}
    assert read <= set(range(1, 41))


def test_unconfigured_units_are_reported_only_in_the_result() -> None:
    units = {each.unit for each in scanned()[1].updates if isinstance(each, Reading | UnitLink)}
    assert units <= set(range(1, CONFIGURED + 1))


def test_addresses_without_a_response_are_probed_again_and_progress_is_reported() -> None:
    progress = reported(scanned()[1])
    assert [each.unit for each in progress] == [1, 2, 3, 4, 5, 6, 7, 8, 6, 7, 8]
    assert [each.done for each in progress] == sorted(each.done for each in progress)
    assert progress[-1].done == 7


def reported(line: VirtualLine) -> list[Progress]:
    """Return the progress that a scan of eight addresses reported."""
    return [update for update in line.updates if isinstance(update, Progress) and update.of == 8]


def test_a_unit_whose_first_response_was_lost_is_found() -> None:
    async def scene(line: VirtualLine) -> Result:
        await asyncio.sleep(2.0)
        line.faults.set(FaultKind.DEAD, 1.0, unit=4)
        scanning = asyncio.create_task(line.perform(ScanBus(1, 8), within_s=600.0))
        await line.until(lambda: any(each.unit == 5 for each in reported(line)))
        line.faults.clear()
        return await scanning

    assert list(kinds(run(scene, PRESENT, configured=CONFIGURED))) == [1, 2, 3, 4, 5]


def test_a_scan_leaves_the_units_two_thirds_of_their_rate() -> None:
    async def scene(line: VirtualLine) -> tuple[float, float]:
        await asyncio.sleep(5.0)
        before = await readings_in(line, asyncio.sleep(2.0))
        meanwhile = await readings_in(line, line.perform(ScanBus(101, 108), within_s=600.0))
        return before, meanwhile

    before, meanwhile = run(scene, 8)
    assert meanwhile > 0.6 * before


async def readings_in(line: VirtualLine, work: Awaitable[object]) -> float:
    """Readings a second while ``work`` goes on."""
    began, had = line.loop.time(), len(line.readings())
    await work
    return (len(line.readings()) - had) / (line.loop.time() - began)


def test_a_device_that_is_no_digimax_is_reported_as_foreign() -> None:
    async def scene(line: VirtualLine) -> Result:
        line.faults.set(FaultKind.WRONG_LENGTH, 1.0, unit=4)
        line.faults.set(FaultKind.CORRUPT, 1.0, unit=5)
        return await scan(line)

    found = kinds(run(scene, PRESENT, configured=CONFIGURED))
    assert (found[1], found[4]) == ("digimax", "foreign")
    assert found.get(5, "garbled") == "garbled"


def test_a_port_lost_meanwhile_ends_it() -> None:
    async def scene(line: VirtualLine) -> Result:
        await asyncio.sleep(2.0)
        command = line.command(ScanBus(1, 255))
        await asyncio.sleep(5.0)
        line.unplug()
        await asyncio.sleep(2.0)
        result = line.result_of(command)
        assert result is not None
        return result

    result = run(scene, PRESENT, configured=CONFIGURED)
    assert result.outcome == "unverified"
    assert "the link to the bus was lost after" in str(result.message)
    assert 1 in kinds(result)
