"""The loop on a virtual line: which unit is polled when, the cost of a timeout, the effect of a cable."""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import Iterable

import pytest

from bus.catalogue import parameters as numbers
from bus.catalogue.parameters import NEEDED_TO_SHOW
from bus.contract import (
    Action,
    BusLink,
    ChangeBaud,
    ParameterValue,
    Progress,
    Reading,
    ReadParameters,
    Result,
    SetLine,
    SetSpeed,
    UnitLink,
    Update,
    Watch,
)
from bus.line.arbiter import RESERVED_S
from bus.line.poll_schedule import LOOK_ELSEWHERE_S
from bus.messages import parameter_name
from bus.simulator.line import FaultKind, WireEventKind
from tests.bus.judge import made_up
from tests.bus.virtual_line import EPOCH, VirtualLine, played

POLL_S = 25 * 10 / 9600


def polls(line: VirtualLine, since: float) -> list[int]:
    return [data[2] for at, data in line.written if at >= since and len(data) == 7 and data[3] == 0x81]


def bus_links(line: VirtualLine) -> list[str]:
    return [update.link for update in line.updates if isinstance(update, BusLink)]


def bus_rates(line: VirtualLine) -> list[int]:
    return [update.baud for update in line.updates if isinstance(update, BusLink)]


def unit_links(line: VirtualLine, unit: int) -> list[str]:
    return [u.link for u in line.updates if isinstance(u, UnitLink) and u.unit == unit]


async def settled(line: VirtualLine) -> None:
    await line.until(lambda: all(line.readings(unit) for unit in line.units))
    await asyncio.sleep(1.5)


@played(8)
async def test_cold_start_to_the_first_reading_of_all_and_to_all_that_shows_them_right(
    line: VirtualLine,
) -> None:
    await line.until(lambda: all(line.readings(unit) for unit in line.units))
    assert line.loop.time() < 0.25
    needed = {(unit, number) for unit in line.units for number in NEEDED_TO_SHOW}
    await line.until(lambda: {(value.unit, value.number) for value in line.parameters()} >= needed)
    assert line.loop.time() < 3.0


@played(2, configured=3)
async def test_steps_of_a_command_are_reported_with_its_result_unless_it_takes_long(
    line: VirtualLine,
) -> None:
    """Each report wakes the app. A unit that does not respond is seen to be asked."""
    await line.until(lambda: line.readings(1) and line.readings(2))
    await asyncio.sleep(1.5)
    put, reports = line.worker.outbox.put, list[list[Update]]()

    def note(updates: Iterable[Update]) -> None:
        reports.append([*updates])
        put(updates)

    line.worker.outbox.put = note  # type: ignore[method-assign]

    async def steps(unit: int) -> list[bool]:
        """Send a command; of each report with a step of it, whether it has the result too."""
        reports.clear()
        await line.perform(SetSpeed(unit, 777))
        own = [report for report in reports if any(isinstance(each, Progress) for each in report)]
        return [any(isinstance(each, Result) for each in report) for report in own]

    assert (await steps(1))[-1]
    assert (await steps(3)).count(False) >= 2


@played(8)
async def test_the_wire_is_never_idle(line: VirtualLine) -> None:
    await settled(line)
    number, began = line.line.record.count, line.loop.time()
    await asyncio.sleep(3)
    entries = line.line.record.since(number, WireEventKind.CAME, WireEventKind.SENT)
    used = sum(len(entry.data) for entry in entries) * 10 / 9600
    assert used / (line.loop.time() - began) > 0.995


@played(8)
async def test_a_write_that_is_announced_leaves_no_later_than_if_it_were_there_already(
    line: VirtualLine,
) -> None:
    """Wherever in a poll it is announced: the poll under way is the last, the write 5 ms later."""
    await settled(line)
    for step in range(13):
        polled = len(polls(line, 0))
        await line.until(lambda polled=polled: len(polls(line, 0)) > polled)
        await asyncio.sleep(step * POLL_S / 13)
        announced = line.loop.time()
        line.worker.reserve()
        await asyncio.sleep(0.005)
        line.command(SetSpeed(unit=3, raw=700))
        await asyncio.sleep(0.1)
        left = next(at for at, data in line.written if at >= announced and data[3] == 0x84)
        assert [at for at, _ in line.written if announced <= at < left] == [], step
        assert left - announced <= max(POLL_S, 0.005) + 0.001, step


@played(8)
async def test_an_announced_write_follows_what_it_is_judged_by(line: VirtualLine) -> None:
    await settled(line)
    announced = line.loop.time()
    line.worker.reserve()
    await asyncio.sleep(0.005)
    assert len((await line.perform(ReadParameters(unit=3, numbers=[8, 2]))).values) == 2
    await asyncio.sleep(0.005)
    line.command(SetSpeed(unit=3, raw=700))
    await asyncio.sleep(0.1)
    frames = [(data[2], data[3]) for at, data in line.written if at >= announced]
    assert frames[: frames.index((3, 0x84))] == [(3, 0x85), (3, 0x81), (3, 0x85)], "a fence, and no poll"


@played(8)
async def test_who_reads_parameters_without_end_leaves_every_second_turn_to_the_scan(
    line: VirtualLine,
) -> None:
    await settled(line)
    began = line.loop.time()
    while line.loop.time() < began + 4:
        line.command(ReadParameters(unit=1, numbers=[1, 2, 3, 4, 5]), timeout_s=20.0)
        line.command(ReadParameters(unit=2, numbers=[1, 2, 3, 4, 5]), timeout_s=20.0)
        await asyncio.sleep(0.1)
    polled = polls(line, began)
    assert len(polled) > 0.45 * 4 / POLL_S
    assert {polled.count(unit) for unit in line.units} <= {len(polled) // 8, len(polled) // 8 + 1}
    requested_at = line.loop.time()
    line.command(SetSpeed(unit=3, raw=700))
    await asyncio.sleep(0.1)
    left = next(at for at, data in line.written if at >= requested_at and data[3] == 0x84)
    assert left - requested_at <= POLL_S + 0.001, "a write is the next frame all the same"


@played(24)
async def test_the_read_back_of_many_units_leaves_every_second_turn_to_the_scan(line: VirtualLine) -> None:
    await settled(line)
    await line.until(lambda: all(line.raws[unit].keys() >= {2, 3, 8} for unit in line.units))
    typed = {unit: {number: line.raws[unit][number] for number in (2, 3, 8)} for unit in line.units}
    speeds = {unit: 500 + unit for unit in line.units if typed[unit][8] == 0}
    result = await line.perform(
        SetLine(speeds), timeout_s=10.0, typed_with={unit: typed[unit] for unit in speeds}
    )
    ended = line.loop.time()
    assert result.outcome == "verified"
    frames = [data for at, data in line.written if at < ended][-60:]
    assert len([data for data in frames if len(data) == 7 and data[3] == 0x81]) >= 25


@played(8)
async def test_a_turn_kept_for_a_write_that_never_comes_costs_a_moment_and_the_units_no_turn(
    line: VirtualLine,
) -> None:
    await settled(line)
    began = line.loop.time()
    while line.loop.time() < began + 3:
        line.worker.reserve()
        await asyncio.sleep(0.001)
    polled = polls(line, began)
    assert len(polled) > 3 / (POLL_S + 2 * RESERVED_S)
    counts = [polled.count(unit) for unit in line.units]
    assert max(counts) - min(counts) <= 2


@pytest.mark.parametrize(
    "action",
    [
        SetSpeed(3, 640),
        SetLine({3: 640}),
        ReadParameters(3, [6]),
    ],
    ids=lambda action: type(action).__name__,
)
@played(8)
async def test_an_operators_command_is_the_very_next_frame(line: VirtualLine, action: Action) -> None:
    await settled(line)
    for _ in range(7):
        await asyncio.sleep(0.0137)
        number, began = len(line.written), line.loop.time()
        command = line.command(action)
        await line.until(lambda command=command: line.result_of(command))
        at, data = line.written[number]
        assert at - began <= POLL_S + 1e-6
        assert data[2] in (0, 3)
        assert data[3] != 0x81


@played(8)
async def test_a_read_back_follows_its_write_at_once(line: VirtualLine) -> None:
    await settled(line)
    number = len(line.written)
    await line.perform(SetSpeed(3, 640))
    sent = [(data[2], data[3]) for _, data in line.written[number:]]
    place = sent.index((3, 0x84))
    assert sent[place : place + 2] == [(3, 0x84), (3, 0x81)]


@played(4)
async def test_endless_writes_do_not_starve_the_scan(line: VirtualLine) -> None:
    await settled(line)
    began = line.loop.time()
    while line.loop.time() < began + 5:
        line.command(SetSpeed(1, 640))
        await asyncio.sleep(0.02)
    seen = polls(line, began)
    assert set(seen) == set(line.units)


@played(3, configured=4)
async def test_a_unit_that_was_never_there_costs_little_and_is_called_offline(line: VirtualLine) -> None:
    await asyncio.sleep(15)
    assert unit_links(line, 4) == ["offline"]
    assert line.worker.line.figures().wire_utilisation > 0.9


@played(4)
async def test_a_pulled_cable_is_seen_within_a_second_and_found_within_three(line: VirtualLine) -> None:
    await settled(line)
    line.unplug()
    await line.until(lambda: bus_links(line)[-1] == "closed", within_s=1.0)
    assert [unit_links(line, unit)[-1] for unit in line.units] == ["stale"] * 4
    result = await line.perform(SetSpeed(1, 640))
    assert result.outcome == "bus_closed"
    assert "adapter" in str(result.message) or "gone" in str(result.message)
    await asyncio.sleep(5)
    assert [unit_links(line, unit)[-1] for unit in line.units] == ["offline"] * 4
    line.plug()
    seen = len(line.readings())
    await line.until(lambda: len(line.readings()) > seen + 4, within_s=3.0)
    assert [unit_links(line, unit)[-1] for unit in line.units] == ["online"] * 4
    assert line.acted() == []


@played(8, turnaround_ms=300)
async def test_a_line_that_is_switched_on_again_is_found_within_three_seconds_however_slow_it_may_be(
    line: VirtualLine,
) -> None:
    await settled(line)
    line.faults.set(FaultKind.DEAD, 1.0)
    await asyncio.sleep(60)
    line.faults.clear()
    await line.until(lambda: all(unit_links(line, unit)[-1] == "online" for unit in line.units), 3.0)


@played(8)
async def test_after_a_cable_was_out_the_scale_of_each_unit_is_read_again_at_once(line: VirtualLine) -> None:
    await settled(line)
    line.unplug()
    await asyncio.sleep(20)
    line.plug()
    plugged = len(line.updates)

    def read_again() -> set[int]:
        found = (each for each in line.updates[plugged:] if isinstance(each, ParameterValue))
        return {each.unit for each in found if each.number == numbers.DECIMALS}

    await line.until(lambda: len(read_again()) == 8, 3.0)


@played(3)
async def test_a_cable_pulled_during_the_first_request_costs_no_unit_its_polls(line: VirtualLine) -> None:
    await line.until(lambda: line.written)
    line.unplug()
    await asyncio.sleep(2)
    assert not line.readings()
    line.plug()
    await line.until(lambda: all(line.readings(unit) for unit in line.units))


@played(4)
async def test_the_next_poll_leaves_before_the_reading_is_reported(line: VirtualLine) -> None:
    await settled(line)
    put, reports = line.worker.outbox.put, []

    def noted(updates: list[Update]) -> None:
        if any(isinstance(update, Reading) for update in updates):
            reports.append((line.loop.time(), line.written[-1]))
        put(updates)

    line.worker.outbox.put = noted  # type: ignore[method-assign]
    await asyncio.sleep(1)
    at_once = [at for at, (sent_at, _) in reports if at == sent_at]
    assert len(at_once) > 0.9 * len(reports) > 20


@played(2)
async def test_a_flood_that_never_frames_holds_nothing_up(line: VirtualLine) -> None:
    await settled(line)
    line.faults.set(FaultKind.FLOOD, 1.0)
    await asyncio.sleep(1)
    began, number = line.loop.time(), len(line.written)
    result = await line.perform(SetSpeed(1, 640))
    assert result.outcome == "unverified"
    assert line.loop.time() - began < 3.0
    await asyncio.sleep(8)
    assert len(line.written) > number + 4, "it continues to poll"
    assert not made_up(line.updates, line.line.record, EPOCH)
    line.faults.clear()
    await line.until(lambda: unit_links(line, 1)[-1] == "online", within_s=15)


@pytest.mark.parametrize(
    "kind",
    [FaultKind.HUGE, FaultKind.ECHO, FaultKind.FOREIGN],
    ids=str,
)
@played(3)
async def test_strange_lines_are_bounded_and_named_in_figures(line: VirtualLine, kind: FaultKind) -> None:
    await settled(line)
    line.faults.set(kind, 0.5, 0 if kind is FaultKind.ECHO else 2)
    await asyncio.sleep(5)
    assert not made_up(line.updates, line.line.record, EPOCH)
    figures = line.worker.line.figures()
    unit = figures.units[1]
    counted = figures.noise_bytes + figures.echoes + unit.foreign + unit.late + unit.checksum_errors
    assert counted > 0
    assert figures.diagnosis


@played(8)
async def test_a_full_read_while_watched_costs_the_scan_no_more_than_a_tenth(line: VirtualLine) -> None:
    await asyncio.sleep(8)
    line.worker.watch(Watch(units=list(line.units)))
    began = line.loop.time()
    await asyncio.sleep(5)
    usual = len(polls(line, began))
    line.command(ReadParameters(1, urgent=False))
    began = line.loop.time()
    await asyncio.sleep(5)
    assert len(polls(line, began)) >= 0.88 * usual


@played(2)
async def test_a_short_timeout_does_not_cost_a_complete_list(line: VirtualLine) -> None:
    await settled(line)
    command = line.command(ReadParameters(1))
    await asyncio.sleep(0.5)
    line.faults.set(FaultKind.DEAD, 1, 1)
    await asyncio.sleep(0.35)
    line.faults.clear()
    await line.until(lambda: line.result_of(command), within_s=60)
    result = _result_of(line, command)
    assert result.outcome == "verified"
    assert sorted(value.number for value in result.values) == list(range(1, 41))
    assert result.values[-1].number != 40, "one was requested again at the end"


@played(2)
async def test_a_unit_that_stops_responding_ends_its_reading(line: VirtualLine) -> None:
    await settled(line)
    line.faults.set(FaultKind.DEAD, 1, 1)
    result = await line.perform(ReadParameters(1), within_s=30)
    assert result.outcome == "unverified"
    why = f"no response to {parameter_name(2)}"
    assert str(result.message) == f"unit 1: 0 of 40 parameters were read, then: {why}"


# --- scan and baud -------------------------------------------------------------------------------


@pytest.mark.parametrize("at_once", [True, False], ids=["at once", "at power-up"])
@played(4)
async def test_the_complete_line_goes_to_another_baud_rate(line: VirtualLine, at_once: bool) -> None:
    _decide(line, [at_once] * 4)
    await settled(line)
    result = await line.perform(ChangeBaud(4800), timeout_s=10)
    assert result.outcome == "verified"
    assert "baud = 4800" in str(result.message)
    for unit in line.plant.units:
        unit.power_up()
    await asyncio.sleep(4 * LOOK_ELSEWHERE_S)
    assert line.worker.line.baud == 4800
    assert [unit_links(line, unit)[-1] for unit in line.units] == ["online"] * 4


@played(3)
async def test_the_new_rate_is_reported_before_any_reading_at_it(line: VirtualLine) -> None:
    _decide(line, [True] * 3)
    await settled(line)
    assert (await line.perform(ChangeBaud(4800), timeout_s=10)).outcome == "verified"
    await asyncio.sleep(1)
    reported = [update for update in line.updates if isinstance(update, BusLink)]
    assert [(each.link, each.baud) for each in reported] == [("open", 9600), ("open", 4800)]
    assert reported[0].at == reported[1].at, "the port was not opened again"
    assert line.worker.snapshot(0).bus == reported[-1]
    last_acted = max(at for at, _, _ in line.acted()) + EPOCH
    at_new_rate = [u for u in line.updates if isinstance(u, Reading) and u.at > last_acted]
    assert line.updates.index(reported[-1]) < line.updates.index(at_new_rate[0])


@played(3, turnaround_ms=300)
async def test_a_slow_line_with_its_first_unit_off_is_found_at_its_new_rate(line: VirtualLine) -> None:
    """Each try on a line without responses costs a long turnaround; both rates must still get theirs in
    turn.
    """
    _decide(line, [False] * 3)
    await settled(line)
    assert (await line.perform(ChangeBaud(4800), timeout_s=20)).outcome == "verified"
    line.faults.set(FaultKind.DEAD, 1.0, 1)
    for unit in line.plant.units:
        unit.power_up()
    await asyncio.sleep(15 * LOOK_ELSEWHERE_S)
    assert line.worker.line.baud == 4800
    assert bus_rates(line)[-1] == 4800
    assert [unit_links(line, unit)[-1] for unit in (2, 3)] == ["online"] * 2


@pytest.mark.parametrize("odd", ["stays", "refuses", "dead", "dies"])
@played(4)
async def test_a_unit_that_does_not_come_along_brings_all_the_others_back(
    line: VirtualLine, odd: str
) -> None:
    _decide(line, [True, True, odd != "stays", True])
    await settled(line)
    if odd == "refuses":
        line.plant.unit(3).memory[numbers.CONTROL_MODE] = 0
    if odd == "dead":
        line.faults.set(FaultKind.DEAD, 1.0, 3)
    command = line.command(ChangeBaud(4800), timeout_s=10)
    if odd == "dies":
        await line.until(lambda: line.plant.unit(3).baud == 4800)
        line.faults.set(FaultKind.DEAD, 1.0, 3)
    await line.until(lambda: line.result_of(command))
    result = _result_of(line, command)
    assert result.outcome == ("refused" if odd == "refuses" else "unverified")
    assert "back at 9600" in str(result.message)
    assert [line.plant.unit(unit).baud for unit in (1, 2, 4)] == [9600] * 3
    if odd in ("dead", "dies"):
        assert "keypad of unit 3" in str(result.message)
    await asyncio.sleep(3)
    assert line.worker.line.baud == 9600
    assert unit_links(line, 1)[-1] == "online"


@played(3)
async def test_a_nak_on_the_retry_does_not_speak_for_the_try_before(line: VirtualLine) -> None:
    """The unit is switched to LOCAL between its lost ACK and the retry: it has the new #18 all the same,
    takes no other over the link, and would leave the line at its next power-up.
    """
    command = await _its_ack_lost_and_then_local(line, 2)
    await line.until(lambda: line.result_of(command))
    result = _result_of(line, command)
    assert result.outcome == "unverified"
    assert "unit 2 rejected" in str(result.message)
    assert "At the keypad of unit 2: set the baud rate (parameter 18) to 96" in str(result.message)
    assert {each.unit: each.outcome for each in result.units} == {
        1: "verified",
        2: "unverified",
        3: "verified",
    }
    assert [unit.memory[numbers.BAUD_RATE] for unit in line.plant.units] == [96, 48, 96]


@played(2)
async def test_an_impossible_baud_rate_is_not_tried(line: VirtualLine) -> None:
    await settled(line)
    assert (await line.perform(ChangeBaud(9600))).outcome == "invalid"
    assert (await line.perform(ChangeBaud(1234))).outcome == "invalid"
    assert line.acted() == []


def _decide(line: VirtualLine, at_once: list[bool]) -> None:
    for unit, now in zip(line.plant.units, at_once, strict=True):
        unit.traits = dataclasses.replace(unit.traits, baud_changes="at once" if now else "at power-up")


async def _its_ack_lost_and_then_local(line: VirtualLine, unit: int) -> str:
    """A change of baud under way: ``unit`` holds its new #18, the ACK got lost, and the retry is refused."""
    _decide(line, [False] * len(line.plant.units))
    await settled(line)
    line.faults.set(FaultKind.LOST, 1.0, unit)
    command = line.command(ChangeBaud(4800), timeout_s=10)
    await line.until(lambda: line.acted(unit))
    line.plant.unit(unit).memory[numbers.CONTROL_MODE] = 0
    line.faults.clear()
    return command


def _result_of(line: VirtualLine, command: str) -> Result:
    result = line.result_of(command)
    assert result is not None
    return result
