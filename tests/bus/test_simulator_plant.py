"""A line of sections, the demo script, and the demo line."""

from __future__ import annotations

import pytest

from bus.catalogue import parameters as numbers
from bus.settings import BusSettings
from bus.simulator.plant import STEP_S, DemoLine, Habit, Plant, Script, Section, demo_line
from bus.simulator.unit import Unit, respond
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


def test_a_long_line_is_at_speed_from_the_first_moment_followers_and_all() -> None:
    line = demo_line(32, script=False)
    line.plant.step()
    assert all(unit.at_speed for unit in line.plant.units)


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
    """Of the moments of twenty minutes nearly all are without a stopped section, yet each habit is seen."""
    line = demo_line()
    steps = round(1200 / STEP_S)
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


def test_a_pressed_contact_is_released() -> None:
    unit = Unit()
    script = Script([unit], [Habit("estop", True, every_s=10, hold_s=2)])
    pressed = []
    for _ in range(2000):
        script.step(0.1)
        pressed.append(unit.inputs.estop)
    assert sum(pressed) == pytest.approx(20 * 20, abs=60)
    assert not all(pressed)


def test_a_contact_that_is_off_by_habit_comes_back_on() -> None:
    unit = Unit()
    script = Script([unit], [Habit("run", False, every_s=10, hold_s=2)])
    states = []
    for _ in range(300):
        script.step(0.1)
        states.append(unit.inputs.run)
    assert set(states) == {True, False}


def test_followers_follow_the_first_unit_that_is_a_master() -> None:
    master, follower = Unit(), Unit()
    follower.memory[numbers.OWN_ADDRESS], follower.memory[numbers.FOLLOWER_MODE] = 2, 1
    master.setpoint, follower.setpoint = 1000, 5000
    plant = Plant([Section(follower), Section(master, seed=2)])
    for _ in range(600):
        plant.step()
    assert follower.measured.actual == pytest.approx(500, abs=5)


def test_an_address_without_a_unit_is_an_error() -> None:
    plant = demo_line(2).plant
    assert plant.unit(2) is plant.units[1]
    with pytest.raises(KeyError):
        plant.unit(3)
