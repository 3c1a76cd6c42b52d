from __future__ import annotations

import pytest

from app.line.live.unit_status import Motion
from bus.catalogue.values import status_bits
from bus.contract import Reading

AT_SPEED, REMOTE, RUN, HEALTHY = 0x80, 0x40, 0x01, 0x02
STOPPED_BY = pytest.mark.parametrize("inputs", [HEALTHY, RUN, 0], ids=["run off", "e-stop", "both"])


def states(
    *seen: tuple[float, int, int, bool], scan_s: float = 0.2, inputs: int = RUN | HEALTHY, ratio: bool = False
) -> list[str]:
    """The states after readings: when, commanded, actual, at speed."""
    motion = Motion()
    found = []
    for at, commanded, actual, at_speed in seen:
        outputs = REMOTE | (AT_SPEED if at_speed else 0)
        reading = Reading(1, at, commanded, actual, analog=0, outputs=outputs, inputs=inputs)
        found.append(motion.note(reading, status_bits(outputs, inputs), scan_s=scan_s, ratio=ratio))
    return found


def test_nothing_seen_is_no_state() -> None:
    assert Motion().state == ""


def test_the_unit_reports_at_speed() -> None:
    assert states((0, 500, 498, True)) == ["at_speed"]


def test_zero_is_zero_whatever_the_bit() -> None:
    assert states((0, 0, 0, True), (1, 0, 0, False)) == ["at_zero", "at_zero"]


def test_an_error_that_shrinks_is_a_ramp_up_or_down() -> None:
    assert states((0, 500, 0, False), (1, 500, 100, False)) == ["ramping_up", "ramping_up"]
    assert states((0, 0, 500, False), (1, 0, 400, False)) == ["ramping_down", "ramping_down"]


def test_an_error_that_does_not_shrink_is_off_speed_after_patience() -> None:
    seen = [(float(at), 500, 400, False) for at in range(5)]
    assert states(*seen) == ["ramping_up"] * 4 + ["off_speed"]


def test_patience_is_three_scans_where_those_are_long() -> None:
    seen = [(6.6 * at, 500, 400, False) for at in range(5)]
    assert states(*seen, scan_s=6.6) == ["ramping_up"] * 4 + ["off_speed"]


def test_a_unit_that_leaves_its_speed_is_off_speed_only_when_it_was_long_there() -> None:
    held = [(float(at), 500, 500, True) for at in range(10)]
    assert states(*held, (9.2, 500, 450, False))[-1] == "ramping_up"
    assert states(*held, (9.2, 500, 450, False), (13.0, 500, 440, False))[-1] == "off_speed"


def test_a_new_setpoint_is_a_new_ramp() -> None:
    stuck = [(float(at), 500, 400, False) for at in range(6)]
    assert states(*stuck, (6.0, 600, 400, False))[-1] == "ramping_up"


@STOPPED_BY
def test_a_unit_without_run_is_stopped_and_not_off_speed(inputs: int) -> None:
    assert states(*((float(at), 500, 0, False) for at in range(6)), inputs=inputs) == ["stopped"] * 6


@STOPPED_BY
def test_a_unit_without_run_slows_down(inputs: int) -> None:
    coasting = [(float(at), 500, 500 - 50 * at, at < 2) for at in range(11)]
    assert states(*coasting, inputs=inputs) == ["stopping"] * 10 + ["stopped"]


@STOPPED_BY
@pytest.mark.parametrize("commanded", [0, 500])
def test_a_unit_that_goes_on_without_run_turns(commanded: int, inputs: int) -> None:
    """At the commanded speed too: the unit reports at speed, and should not move at all."""
    seen = [(float(at), commanded, 500, commanded == 500) for at in range(5)]
    assert states(*seen, inputs=inputs) == ["stopping"] * 4 + ["turning"]


def test_ratios_do_not_show_whether_the_motor_turns() -> None:
    seen = [(float(at), 10_000, 9_990, False) for at in range(5)]
    assert states(*seen, inputs=HEALTHY, ratio=True) == [""] * 5
