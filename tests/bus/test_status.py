"""ST2 and ST1, bit by bit."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.catalogue.status import output_is_on, status_bits

octets = st.integers(0, 255)


@pytest.mark.parametrize(
    ("bit", "field"), [(0, "run"), (2, "preset"), (3, "reverse"), (4, "up"), (5, "down"), (6, "follower")]
)
def test_each_input_has_its_bit(bit: int, field: str) -> None:
    assert getattr(status_bits(0, 1 << bit), field)
    assert not getattr(status_bits(0, ~(1 << bit) & 0xFF), field)


@pytest.mark.parametrize("number", range(1, 7))
def test_each_output_has_its_bit(number: int) -> None:
    assert status_bits(1 << number - 1, 0).outputs == tuple(n == number for n in range(1, 7))
    assert output_is_on(1 << number - 1, number)
    assert not output_is_on(~(1 << number - 1) & 0xFF, number)


def test_at_speed_and_remote() -> None:
    assert status_bits(0x80, 0).at_speed
    assert not status_bits(0x80, 0).remote
    assert status_bits(0x40, 0).remote
    assert not status_bits(0x40, 0).at_speed


@pytest.mark.parametrize(
    ("bit", "healthy", "active"), [(1, 1, False), (0, 1, True), (1, 0, True), (0, 0, False)]
)
def test_the_sense_of_the_emergency_stop_is_the_dialects(bit: int, healthy: int, active: bool) -> None:
    assert status_bits(0, bit << 1, healthy).estop_active is active


@given(octets, octets, st.sampled_from([0, 1]))
def test_bits_round_trip(outputs: int, inputs: int, healthy: int) -> None:
    bits = status_bits(outputs, inputs, healthy)
    estop = bits.estop_active != bool(healthy)
    assert _byte(*bits.outputs, bits.remote, bits.at_speed) == outputs
    assert (
        _byte(bits.run, estop, bits.preset, bits.reverse, bits.up, bits.down, bits.follower) == inputs & 0x7F
    )


def _byte(*bits: bool) -> int:
    return sum(bit << position for position, bit in enumerate(bits))


@given(octets)
def test_bit_7_of_the_inputs_means_nothing(inputs: int) -> None:
    assert status_bits(0, inputs) == status_bits(0, inputs ^ 0x80)


def test_each_input_has_a_name_for_programs() -> None:
    names = ("run", "estop", "preset", "reverse", "up", "down", "slave")
    for place, name in enumerate(names):
        inputs = status_bits(0, 1 << place, estop_healthy=0).inputs
        assert [each for each, on in inputs.items() if on] == [name]
