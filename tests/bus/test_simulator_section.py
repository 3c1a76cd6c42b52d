"""The physics of a section: ramps, window, followers, contacts, tension; stepped, seeded, without a clock."""

from __future__ import annotations

import pytest

from bus.catalogue import parameters as numbers
from bus.simulator.plant import Section
from bus.simulator.unit import Memory, Unit

DT = 0.05
FULL = 2000


def section(seed: int = 1, **values: int) -> Section:
    """A section with #1 1750 rpm, #2 2000 and ramps of 10 s for the full span, but for ``values``."""
    named = {getattr(numbers, name): raw for name, raw in values.items()}
    return Section(Unit(Memory(named)), seed)


def run(machine: Section, seconds: float, master_rpm: float = 0.0, upstream: Section | None = None) -> int:
    for _ in range(round(seconds / DT)):
        machine.step(DT, master_rpm, upstream)
    return machine.unit.measured.actual


@pytest.mark.parametrize(("seconds", "share"), [(2.5, 0.25), (5, 0.5), (20, 1.0)])
def test_it_accelerates_by_the_time_for_the_full_span(seconds: float, share: float) -> None:
    machine = section(SPEED_SETPOINT=FULL, ACCELERATION=100)
    assert run(machine, seconds) == pytest.approx(FULL * share, abs=40)


def test_it_slows_down_by_its_own_ramp() -> None:
    machine = section(SPEED_SETPOINT=FULL, ACCELERATION=10, DECELERATION=200)
    run(machine, 5)
    machine.unit.setpoint = 0
    assert run(machine, 10) == pytest.approx(FULL / 2, abs=40)


def test_a_ramp_of_nought_is_no_ramp() -> None:
    assert run(section(SPEED_SETPOINT=1000, ACCELERATION=0), 1.5) == pytest.approx(1000, abs=5)


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
    run(machine, 20)
    machine.unit.inputs.run = False
    coasting = run(machine, 2)
    assert 0 < coasting < FULL * 0.6
    assert not machine.unit.at_speed
    machine.unit.inputs.run = True
    assert run(machine, 1) > coasting
    machine.unit.inputs.run = False
    assert run(machine, 60) == 0


def test_an_emergency_stop_is_much_faster_than_coasting() -> None:
    machine = section(SPEED_SETPOINT=FULL)
    run(machine, 20)
    machine.unit.inputs.estop = True
    assert run(machine, 1) < FULL * 0.05
    assert run(machine, 3) == 0
    assert machine.unit.commanded == FULL


@pytest.mark.parametrize(("ratio", "base"), [(10000, 10000), (5000, 10000), (10500, 10000), (10000, 5000)])
def test_a_follower_holds_its_ratio_to_the_master(ratio: int, base: int) -> None:
    machine = section(FOLLOWER_MODE=1, RATIO_SETPOINT=ratio, BASE_RATIO=base)
    actual = run(machine, 30, master_rpm=875)
    expected = FULL / 2 * ratio / 10000 * base / 10000
    assert actual == pytest.approx(expected, abs=5)
    assert machine.unit.measured.following == pytest.approx(expected, abs=1)
    assert machine.unit.measured.ratio == pytest.approx(ratio, rel=0.01)
    assert machine.unit.at_speed


def test_an_inverse_follower_divides_by_its_ratio() -> None:
    assert run(section(FOLLOWER_MODE=2, RATIO_SETPOINT=20000), 30, master_rpm=875) == pytest.approx(
        500, abs=5
    )


def test_a_follower_rests_while_its_master_does() -> None:
    machine = section(FOLLOWER_MODE=1)
    assert run(machine, 5, master_rpm=0) == 0
    assert machine.unit.measured.ratio == 0


def test_reverse_turns_the_motor_the_other_way_and_shows_the_same_speed() -> None:
    machine = section(SPEED_SETPOINT=1000)
    machine.unit.inputs.reverse = True
    assert run(machine, 20) == pytest.approx(1000, abs=5)
    assert machine.rpm < 0


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


def test_the_same_seed_gives_the_same_speeds_and_another_seed_others() -> None:
    def course(seed: int) -> list[int]:
        machine = section(seed, SPEED_SETPOINT=1000)
        return [run(machine, DT) for _ in range(400)]

    assert course(1) == course(1)
    assert course(1) != course(2)


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
    assert run(machine, 1, master_rpm=100) == 0
