"""The simulated machine: the motors of its sections, and lines to look at."""

from __future__ import annotations

import pytest

from bus.catalogue import parameters as numbers
from bus.settings import BusSettings
from bus.simulator.plant import STEP_S, DemoLine, Plant, Section, demo_line
from bus.simulator.unit import Memory, Unit, respond
from bus.wire.commands import encode_reply


def responses(line: DemoLine) -> bytes:
    """Return the responses of every unit to 81h."""
    sent = b""
    for unit in line.plant.units:
        reply = respond(unit, bytes((unit.address, 0x81))).reply
        assert reply is not None
        sent += encode_reply(reply, unit.traits.dialect)
    return sent


def run(line: DemoLine, seconds: int) -> None:
    for _ in range(round(seconds / STEP_S)):
        line.plant.step()


def test_the_same_seed_gives_the_same_bytes_after_a_minute() -> None:
    lines = [demo_line(8, seed=seed) for seed in (5, 5, 6)]
    for line in lines:
        run(line, 60)
    first, same, other = map(responses, lines)
    assert first == same
    assert first != other


def test_the_default_demo_is_eight_named_sections_that_run_in_metres_a_minute() -> None:
    line = demo_line()
    assert [unit.name for unit in line.settings] == [
        "Unwind",
        "Infeed nip",
        "Coater",
        "Dryer 1",
        "Dryer 2",
        "Cooling drum",
        "Pull nip",
        "Rewind",
    ]
    for unit in line.plant.units:
        assert (unit.memory[numbers.DECIMALS], unit.follows) == (1, False)
        assert unit.measured.actual == pytest.approx(1200, abs=10)
        assert unit.at_speed


@pytest.mark.parametrize("count", [1, 8, 9, 32, 255])
def test_any_number_of_units_makes_a_bus_that_the_settings_take(count: int) -> None:
    line = demo_line(count)
    bus = BusSettings(name="demo", port="/dev/null", unit=line.settings)
    assert [unit.id for unit in bus.unit] == [unit.address for unit in line.plant.units]
    assert len({unit.name for unit in bus.unit}) == count
    assert not line.plant.units[0].follows
    assert any(unit.follows for unit in line.plant.units) == (count >= 16)


@pytest.mark.parametrize("unrest", [True, False])
def test_a_line_without_unrest_measures_the_same_as_long_as_nothing_is_changed(unrest: bool) -> None:
    line = demo_line(4, script=False, unrest=unrest)
    for _ in range(100):  # until the web is taut
        line.plant.step()
    measured = set()
    for _ in range(100):
        line.plant.step()
        measured.add(tuple((unit.measured.actual, unit.measured.analog) for unit in line.plant.units))
    assert (len(measured) == 1) is not unrest


def test_the_demo_line_is_mostly_well_and_not_always() -> None:
    """Of the moments of ten minutes nearly all are without a stopped section, yet each habit is seen."""
    line = demo_line()
    steps = round(600 / STEP_S)
    stopped, seen = 0, set()
    for _ in range(steps):
        line.plant.step()
        contacts = [unit.inputs for unit in line.plant.units]
        stopped += any(inputs.estop or not inputs.run for inputs in contacts)
        seen |= {
            name for inputs in contacts for name in ("estop", "preset", "up", "down") if getattr(inputs, name)
        }
    assert seen == {"estop", "preset", "up", "down"}
    assert 0.02 < stopped / steps < 0.2


def test_followers_follow_the_first_unit_that_is_a_master() -> None:
    master, follower = Unit(), Unit()
    follower.memory[numbers.OWN_ADDRESS], follower.memory[numbers.FOLLOWER_MODE] = 2, 1
    master.setpoint, follower.setpoint = 1000, 5000
    plant = Plant([Section(follower), Section(master, seed=2)])
    for _ in range(600):
        plant.step()
    assert follower.measured.actual == pytest.approx(500, abs=5)


DT = 0.05
FULL = 2000


def section(seed: int = 1, **values: int) -> Section:
    """A section with #1 1750 rpm, #2 2000 and ramps of 10 s for the full span, but for ``values``."""
    named = {getattr(numbers, name): raw for name, raw in values.items()}
    return Section(Unit(Memory(named)), seed)


def turn(machine: Section, seconds: float, master_rpm: float = 0.0, upstream: Section | None = None) -> int:
    for _ in range(round(seconds / DT)):
        machine.step(DT, master_rpm, upstream)
    return machine.unit.measured.actual


@pytest.mark.parametrize(("seconds", "share"), [(2.5, 0.25), (5, 0.5), (20, 1.0)])
def test_it_accelerates_by_the_time_for_the_full_span(seconds: float, share: float) -> None:
    machine = section(SPEED_SETPOINT=FULL, ACCELERATION=100)
    assert turn(machine, seconds) == pytest.approx(FULL * share, abs=40)


def test_at_speed_is_the_window_around_the_command() -> None:
    machine = section(SPEED_SETPOINT=1000, AT_SPEED_WINDOW=10)
    seen = set()
    for _ in range(300):
        machine.step(DT, 0.0, None)
        near = abs(machine.unit.measured.actual - 1000) <= 10
        assert machine.unit.at_speed == near
        seen.add(near)
    assert seen == {True, False}


def test_a_drive_that_does_not_run_coasts_and_runs_up_again_from_where_it_is() -> None:
    machine = section(SPEED_SETPOINT=FULL, ACCELERATION=100)
    turn(machine, 20)
    machine.unit.inputs.run = False
    coasting = turn(machine, 2)
    assert 0 < coasting < FULL * 0.6
    assert not machine.unit.at_speed
    machine.unit.inputs.run = True
    assert turn(machine, 1) > coasting
    machine.unit.inputs.run = False
    assert turn(machine, 60) == 0


def test_an_emergency_stop_is_much_faster_than_coasting() -> None:
    machine = section(SPEED_SETPOINT=FULL)
    turn(machine, 20)
    machine.unit.inputs.estop = True
    assert turn(machine, 1) < FULL * 0.05
    assert turn(machine, 3) == 0
    assert machine.unit.commanded == FULL


@pytest.mark.parametrize(("ratio", "base"), [(10000, 10000), (5000, 10000), (10500, 10000), (10000, 5000)])
def test_a_follower_holds_its_ratio_to_the_master(ratio: int, base: int) -> None:
    machine = section(FOLLOWER_MODE=1, RATIO_SETPOINT=ratio, BASE_RATIO=base)
    actual = turn(machine, 30, master_rpm=875)
    expected = FULL / 2 * ratio / 10000 * base / 10000
    assert actual == pytest.approx(expected, abs=5)
    assert machine.unit.measured.following == pytest.approx(expected, abs=1)
    assert machine.unit.measured.ratio == pytest.approx(ratio, rel=0.01)
    assert machine.unit.at_speed


def test_the_web_tightens_where_a_section_runs_ahead_of_the_one_before() -> None:
    before, ahead, behind = (section(SPEED_SETPOINT=speed) for speed in (1000, 1010, 990))
    for machine in (before, ahead, behind):
        machine.settle()
    for _ in range(100):
        before.step(DT, 0.0, None)
        ahead.step(DT, 0.0, before)
        behind.step(DT, 0.0, before)
    analogs = [machine.unit.measured.analog for machine in (behind, before, ahead)]
    assert analogs == sorted(analogs)
    assert analogs[2] - analogs[0] > 20


def test_everything_shown_fits_its_bytes() -> None:
    machine = section(SPEED_SETPOINT=99999, MAX_DISPLAY=99999, ACCELERATION=0)
    for estop in (False, True):
        machine.unit.inputs.estop = estop
        for _ in range(200):
            machine.step(DT, 0.0, None)
            assert 0 <= machine.unit.measured.actual <= 99999
            assert 0 <= machine.unit.measured.analog <= 255


def test_odd_parameters_do_not_break_the_machine() -> None:
    machine = section(FOLLOWER_MODE=2, RATIO_SETPOINT=0, MAX_RPM=0, MAX_DISPLAY=0)
    assert turn(machine, 1, master_rpm=100) == 0
