"""The line as one: all or nothing, nothing stray, one change at a time. Played on the virtual line."""

from __future__ import annotations

import asyncio

import pytest

from bus.catalogue import parameters as numbers
from bus.contract import ExecuteAll, Progress, ReadParameters, Result, SetLine, SetSpeed, Staged
from bus.simulator.line import FaultKind, WireEventKind
from bus.simulator.unit import Mode
from tests.bus.virtual_line import VirtualLine, played

ALL = {1: 501, 2: 502, 3: 503, 4: 504}


def received(line: VirtualLine, command: int, since: int = 0) -> list[bytes]:
    """Requests of one command that reached a unit, in order; a broadcast once."""
    bodies: list[bytes] = []
    for entry in line.line.record.since(since, WireEventKind.RECEIVED):
        if entry.data[1] == command and (entry.data[0] or not bodies or bodies[-1][0]):
            bodies.append(entry.data)
    return bodies


def setpoints(line: VirtualLine) -> list[int]:
    return [unit.setpoint for unit in line.plant.units]


def entered(line: VirtualLine) -> list[int]:
    return [unit.entered for unit in line.plant.units]


def by_unit(result: Result) -> dict[int, str]:
    return {unit.unit: unit.outcome for unit in result.units}


async def settled(line: VirtualLine) -> None:
    await line.until(lambda: all(line.readings(unit) for unit in line.units))
    await asyncio.sleep(1.5)


async def staged_up_to(line: VirtualLine, unit: int) -> tuple[list[int], str]:
    """Begin to set all units, and wait until one has its value staged. Return the setpoints before, and the
    command."""
    await settled(line)
    before = setpoints(line)
    command = line.command(SetLine(ALL))
    await line.until(lambda: entered(line)[unit - 1] == ALL[unit])
    return before, command


@played(4)
async def test_stage_all_one_broadcast_read_back_all(line: VirtualLine) -> None:
    await settled(line)
    began = line.line.record.count
    result = await line.perform(SetLine(ALL))
    assert result.outcome == "verified"
    assert setpoints(line) == [501, 502, 503, 504]
    requests = [e.data for e in line.line.record.since(began, WireEventKind.RECEIVED)]
    first = next(place for place, body in enumerate(requests) if body[1] == 0x82)
    commands = [body[1] for body in requests[first : first + 12]]
    assert commands == [0x82] * 4 + [0x83] * 4 + [0x81] * 4, "nothing between, and one 83h for all"
    assert len(received(line, 0x83, began)) == 1
    for unit in result.units:
        assert unit.sent_at is not None
        assert unit.acknowledged_at is not None
        assert unit.proven_at is not None
        assert unit.sent_at < unit.acknowledged_at < unit.proven_at
    assert result.skew_s is not None
    assert 0.026 < result.skew_s < 0.2


@pytest.mark.parametrize("fault", ["local", "dead", "refuses"])
@played(4)
async def test_one_that_cannot_stops_it_before_the_broadcast(line: VirtualLine, fault: str) -> None:
    await settled(line)
    before = setpoints(line)
    change = dict(ALL)
    if fault == "local":
        line.plant.unit(3).memory[numbers.CONTROL_MODE] = Mode.LOCAL
    elif fault == "dead":
        line.faults.set(FaultKind.DEAD, 1.0, 3)
    else:
        change[3] = line.plant.unit(3).highest + 1
    result = await line.perform(SetLine(change))
    assert result.outcome == ("unverified" if fault == "dead" else "refused")
    assert "unit 3" in str(result.message)
    assert "no unit was changed" in str(result.message)
    assert not received(line, 0x83)
    assert setpoints(line) == before
    line.faults.clear()
    line.plant.unit(3).memory[numbers.CONTROL_MODE] = Mode.REMOTE
    result = await line.perform(ExecuteAll())
    assert setpoints(line) == before, "a stray execute changes nothing"
    assert line.worker.line.roster[1].staged is None


@played(4)
async def test_staged_values_are_put_back_and_reported(line: VirtualLine) -> None:
    await settled(line)
    change = {**ALL, 4: line.plant.unit(4).highest + 1}
    result = await line.perform(SetLine(change))
    assert by_unit(result) == {1: "not_sent", 2: "not_sent", 3: "not_sent", 4: "refused"}
    assert "staged again" in str(result.units[0].message)
    assert entered(line) == setpoints(line)
    reported = [update.raw for update in line.updates if isinstance(update, Staged) and update.unit == 1]
    assert (reported[0], reported[-1]) == (501, None)


@played(4)
async def test_a_unit_known_to_be_local_is_read_first_so_that_nothing_is_staged_in_vain(
    line: VirtualLine,
) -> None:
    line.plant.unit(4).memory[numbers.CONTROL_MODE] = Mode.LOCAL
    await settled(line)
    result = await line.perform(SetLine(ALL))
    assert result.outcome == "refused"
    assert [body[0] for body in received(line, 0x82)] == [4]


@played(4)
async def test_a_unit_without_a_response_that_may_hold_its_stage_is_named(line: VirtualLine) -> None:
    await settled(line)
    line.faults.set(FaultKind.LOST, 1.0, 2)
    result = await line.perform(SetLine(ALL))
    assert result.outcome == "unverified"
    assert "may still be staged in unit 2" in str(result.message)
    assert not received(line, 0x83)


@played(4)
async def test_a_unit_outside_the_change_keeps_its_staged_speed_and_does_not_move(line: VirtualLine) -> None:
    await settled(line)
    old = line.plant.unit(4).setpoint
    assert (await line.perform(SetSpeed(4, 777, execute=False))).outcome == "acknowledged"
    result = await line.perform(SetLine({1: 501, 2: 502}))
    assert result.outcome == "verified"
    assert line.plant.unit(4).setpoint == old
    assert line.plant.unit(4).entered == 777
    assert line.worker.line.roster[4].staged == 777
    result = await line.perform(ExecuteAll())
    assert result.outcome == "verified"
    assert line.plant.unit(4).setpoint == 777


@played(4)
async def test_a_value_staged_by_another_host_is_reported(line: VirtualLine) -> None:
    await settled(line)
    line.plant.unit(4).entered = 321
    result = await line.perform(SetLine({1: 501}))
    assert result.outcome == "verified"
    assert "unit 4" in str(result.message)
    assert "321" in str(result.message)


@played(4)
async def test_a_follower_that_slows_with_its_master_is_no_stray(line: VirtualLine) -> None:
    line.plant.unit(4).memory[numbers.FOLLOWER_MODE] = 1
    await settled(line)
    await line.perform(SetLine({1: 500, 2: 500, 3: 500}))
    await line.perform(ReadParameters(4, [numbers.FOLLOWER_MODE]))
    result = await line.perform(SetLine({1: 0, 2: 0, 3: 0}))
    assert (result.outcome, result.message) == ("verified", None)


@played(4)
async def test_two_changes_at_once_are_never_mixed(line: VirtualLine) -> None:
    await settled(line)
    ids = [line.command(SetLine(dict.fromkeys(range(1, 5), raw))) for raw in (300, 400)]
    single = line.command(SetSpeed(2, 450))
    await asyncio.sleep(2.0)
    results = [line.result_of(each) for each in (*ids, single)]
    assert [result and result.outcome for result in results] == ["verified"] * 3
    staged = [int.from_bytes(body[2:], "big") for body in received(line, 0x82)]
    assert staged == [300] * 4 + [400] * 4
    assert setpoints(line) == [400, 450, 400, 400]


@played(4)
async def test_the_second_of_two_changes_is_refused_in_words_when_its_time_is_over(line: VirtualLine) -> None:
    await settled(line)
    line.command(SetLine(dict.fromkeys(range(1, 5), 300)), timeout_s=2.0)
    second = line.command(SetLine(dict.fromkeys(range(1, 5), 400)), timeout_s=0.1)
    await asyncio.sleep(2.0)
    result = line.result_of(second)
    assert result is not None
    assert result.outcome == "not_sent"
    assert setpoints(line) == [300] * 4


@played(4)
async def test_no_time_for_the_stages_is_reported_before_anything_is_sent(line: VirtualLine) -> None:
    await settled(line)
    result = await line.perform(SetLine(ALL), timeout_s=0.05)
    assert result.outcome == "not_sent"
    assert "takes" in str(result.message)
    assert not received(line, 0x82)


@pytest.mark.parametrize("above", ["preset", "follower"])
@played(4)
async def test_a_unit_whose_own_setpoint_is_staged_holds_none_whatever_its_status_shows(
    line: VirtualLine, above: str
) -> None:
    unit = line.plant.unit(2)
    if above == "follower":
        unit.memory[numbers.FOLLOWER_MODE] = 1
    else:
        setattr(unit.inputs, above, True)
    await settled(line)
    number = numbers.RATIO_SETPOINT if above == "follower" else numbers.SPEED_SETPOINT
    own = unit.memory[number]
    assert (await line.perform(SetSpeed(2, own + 1, execute=False))).outcome == "acknowledged"
    assert line.worker.line.roster[2].staged == own + 1
    assert (await line.perform(SetSpeed(2, own, execute=False))).outcome == "acknowledged"
    assert line.worker.line.roster[2].staged is None


@played(4)
async def test_a_change_whose_time_runs_out_is_withdrawn(line: VirtualLine) -> None:
    await settled(line)
    before = setpoints(line)
    line.faults.set(FaultKind.LOST, 1.0, 3)
    result = await line.perform(SetLine(ALL), timeout_s=0.12)
    assert result.outcome in ("not_sent", "unverified")
    assert not received(line, 0x83)
    line.faults.clear()
    await line.perform(ExecuteAll())
    assert [setpoints(line)[place] for place in (0, 1, 3)] == [before[place] for place in (0, 1, 3)]


async def unit_2_misses_the_broadcast(line: VirtualLine, *, back: bool) -> Result:
    """It has acknowledged its 502 and is off when the others execute; ``back``: on again right after it."""
    _, command = await staged_up_to(line, 2)
    line.faults.set(FaultKind.DEAD, 1.0, 2)
    await line.until(lambda: setpoints(line)[0] == 501)
    if back:
        line.faults.clear()
    await line.until(lambda: line.result_of(command))
    result = line.result_of(command)
    assert result is not None
    return result


@played(4)
async def test_a_unit_that_missed_the_broadcast_gets_a_single_execute(line: VirtualLine) -> None:
    result = await unit_2_misses_the_broadcast(line, back=True)
    assert result.outcome == "verified"
    assert "singly" in str(result.message)
    assert setpoints(line)[1] == 502


@played(4)
async def test_a_unit_that_missed_the_broadcast_and_stops_responding_is_reported_as_maybe_staged(
    line: VirtualLine,
) -> None:
    result = await unit_2_misses_the_broadcast(line, back=False)
    assert result.outcome == "unverified"
    assert entered(line)[1] == 502
    assert "unit 2: it did not respond to the read-back; 502 may still be staged in it" in str(result.message)


@played(4)
async def test_given_up_before_the_broadcast_it_is_withdrawn(line: VirtualLine) -> None:
    before, command = await staged_up_to(line, 2)
    line.worker.cancel(command)
    await asyncio.sleep(1.0)
    result = line.result_of(command)
    assert result is not None
    assert result.outcome == "not_sent"
    assert setpoints(line) == before
    assert entered(line) == before


@played(4)
async def test_a_leaving_worker_finishes_or_withdraws_the_change(line: VirtualLine) -> None:
    before, command = await staged_up_to(line, 1)
    began = line.loop.time()
    await line.worker.finish()
    assert line.loop.time() - began < 2.0
    assert line.result_of(command) is not None
    assert setpoints(line) in (before, list(ALL.values()))
    assert entered(line) == setpoints(line)


@played(4)
async def test_a_pulled_cable_in_the_middle_leaves_what_may_be_staged_in_words(line: VirtualLine) -> None:
    before, command = await staged_up_to(line, 2)
    line.unplug()
    await asyncio.sleep(2.0)
    result = line.result_of(command)
    assert result is not None
    assert result.outcome == "bus_closed"
    assert "may still be staged in unit 1" in str(result.message)
    line.plug()
    await asyncio.sleep(3.0)
    assert setpoints(line) == before, "nothing is sent late"
    assert line.worker.line.roster[1].staged == 501, "and what is known stays shown"


@played(4)
async def test_progress_counts_the_units(line: VirtualLine) -> None:
    await settled(line)
    await line.perform(SetLine(ALL))
    reported = [update for update in line.updates if isinstance(update, Progress)]
    assert [update.stage for update in reported] == [
        "waiting",
        *["sent"] * 4,
        "acknowledged",
        *["proving"] * 4,
    ]
    assert [update.done for update in reported if update.stage == "proving"] == [0, 1, 2, 3]


# --- execute all ---------------------------------------------------------------------------------


@played(4)
async def test_execute_all_verifies_staged_units_and_names_the_others(line: VirtualLine) -> None:
    await settled(line)
    await line.perform(SetSpeed(1, 601, execute=False))
    await line.perform(SetSpeed(2, 602, execute=False))
    result = await line.perform(ExecuteAll())
    assert result.outcome == "verified"
    assert [unit.read_back for unit in result.units][:2] == [601, 602]
    assert "nothing was staged from here" in str(result.units[2].message)
    assert line.worker.line.roster[1].staged is None
