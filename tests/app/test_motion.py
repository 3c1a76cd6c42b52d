from __future__ import annotations

from app.live.motion import Motion
from bus.contract import Reading


def reading(at: float, commanded: int, actual: int) -> Reading:
    return Reading(unit=1, at=at, commanded=commanded, actual=actual, analog=0, outputs=0, inputs=0)


def states(*seen: tuple[float, int, int, bool], scan_s: float = 0.2) -> list[str]:
    motion = Motion()
    return [motion.see(reading(at, c, a), at_speed=at_speed, scan_s=scan_s) for at, c, a, at_speed in seen]


def test_nothing_seen_is_no_state() -> None:
    assert Motion().state == ""


def test_the_unit_says_at_speed() -> None:
    assert states((0, 500, 498, True)) == ["at_speed"]


def test_zero_is_zero_whatever_the_bit_says() -> None:
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


def test_a_condition_has_its_beginning_where_that_was_seen() -> None:
    motion = Motion()
    motion.note(10.0, frozenset({"mode"}))
    assert motion.since == {}
    motion.note(20.0, frozenset({"mode", "estop"}))
    motion.note(30.0, frozenset({"mode", "estop"}))
    assert motion.since == {"estop": 20.0}
    motion.note(40.0, frozenset())
    motion.note(50.0, frozenset({"mode"}))
    assert motion.since == {"mode": 50.0}
