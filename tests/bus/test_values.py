"""Raw integers and the numbers people use; ST2 and ST1, bit by bit."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.catalogue.parameters import PARAMETERS, IllegalValue, Parameter
from bus.catalogue.values import (
    analog_input_value,
    analog_output_volts,
    is_follower,
    output_is_on,
    parameter_raw,
    parameter_text,
    parameter_unit,
    plausible_parameter,
    plausible_speed,
    ratio_raw,
    ratio_text,
    rpm,
    speed_raw,
    speed_text,
    status_bits,
)
from bus.errors import CallerError
from tests.for_each import for_each

octets = st.integers(0, 255)


@pytest.mark.parametrize("number", range(1, 7))
def test_each_output_has_its_bit(number: int) -> None:
    assert status_bits(1 << number - 1, 0).outputs == tuple(n == number for n in range(1, 7))
    assert output_is_on(1 << number - 1, number)
    assert not output_is_on(~(1 << number - 1) & 0xFF, number)


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


raws = st.integers(0, 99_999)
places = st.integers(0, 4)


@given(raws, places)
def test_speeds_round_trip(raw: int, decimals: int) -> None:
    text = speed_text(raw, decimals)
    assert speed_raw(text, decimals) == speed_raw(text.replace(".", ","), decimals) == raw
    assert float(text) == raw / 10**decimals


@pytest.mark.parametrize(
    ("raw", "decimals", "text"),
    [(12345, 1, "1234.5"), (12345, 0, "12345"), (5, 4, "0.0005"), (0, 2, "0.00"), (99_999, 4, "9.9999")],
)
def test_speed_text(raw: int, decimals: int, text: str) -> None:
    assert speed_text(raw, decimals) == text


@pytest.mark.parametrize(("text", "raw"), [("1234.5", 12345), (" 1234,5 ", 12345), ("7", 70), ("007.0", 70)])
def test_speed_raw(text: str, raw: int) -> None:
    assert speed_raw(text, 1) == raw


@pytest.mark.parametrize(
    "text",
    [
        "+1",
        "--1",
        "-",
        "1.2.3",
        "1,2,3",
        "1e3",
        "0x10",
        "nan",
        ".5",
        "5.",
        "1 234",
        "١٢",
        "1234567890",
        "1_0",
    ],
)
def test_a_text_that_is_not_a_number(text: str) -> None:
    with pytest.raises(CallerError, match=r"not a number: '.*'; write it like 12\.34"):
        speed_raw(text, 2)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("", "empty is not zero"),
        (" ", "empty is not zero"),
        ("-1", "below 0"),
        ("\N{MINUS SIGN}0,5", "below 0"),
    ],
)
def test_the_fault_of_a_number_is_stated(text: str, error: str) -> None:
    with pytest.raises(CallerError, match=error):
        speed_raw(text, 2)


@pytest.mark.parametrize(("text", "nearest"), [("12.55", 126), ("12,549", 125), ("-3", 0)])
def test_a_refused_number_has_a_nearest_one(text: str, nearest: int) -> None:
    with pytest.raises(IllegalValue, match=re.escape(text)) as refused:
        speed_raw(text, 1)
    assert refused.value.nearest == nearest


@pytest.mark.parametrize("text", ["1.000", "1.50", "0,25"])
def test_more_decimals_than_shown_are_refused_zeros_too(text: str) -> None:
    with pytest.raises(CallerError, match="at most 1"):
        speed_raw(text, 1)
    with pytest.raises(CallerError, match="has no"):
        speed_raw(text, 0)


@given(raws)
def test_ratios_round_trip(raw: int) -> None:
    assert ratio_raw(ratio_text(raw)) == raw


@pytest.mark.parametrize(("mode", "follows"), [(0, False), (1, True), (2, True), (3, False), (None, False)])
def test_which_modes_make_a_follower(mode: int | None, follows: bool) -> None:
    assert is_follower(mode) is follows


def test_a_ratio_has_four_decimals() -> None:
    assert ratio_text(10_000) == "1.0000"
    assert ratio_raw("1,05") == 10_500


def test_analog_input() -> None:
    assert analog_input_value(0, 20, 120) == 20
    assert analog_input_value(255, 20, 120) == 120
    assert analog_input_value(51, 0, 100) == pytest.approx(20)
    assert analog_input_value(255, 100, 0) == 0


@pytest.mark.parametrize(
    ("raw", "low", "high", "volts"),
    [(2000, 0, 2000, 10), (350, 0, 2000, 1.75), (350, 100, 2000, 1.316), (100, 100, 2000, 0)],
)
def test_analog_output_follows_the_manuals_formula_not_its_second_example(
    raw: int, low: int, high: int, volts: float
) -> None:
    assert analog_output_volts(raw, low, high) == pytest.approx(volts, abs=5e-4)


def test_analog_output_without_a_span_means_nothing() -> None:
    with pytest.raises(CallerError, match="29 and 30\\) are equal"):
        analog_output_volts(5, 7, 7)


def test_rpm() -> None:
    assert rpm(5000, 1750, 10_000) == 875
    with pytest.raises(CallerError, match="parameter 2\\) is 0"):
        rpm(5000, 1750, 0)


@pytest.mark.parametrize(
    ("number", "raw", "decimals", "text", "unit"),
    [
        (1, 1750, 1, "1750", "rpm"),
        (2, 10_000, 1, "1000.0", ""),
        (2, 10_000, None, "10000 raw", ""),
        (3, 1, 1, "1", ""),
        (6, 50, None, "5.0", "s"),
        (6, 9999, None, "999.9", "s"),
        (8, 1, None, "Follower", ""),
        (9, 12_345, 2, "123.45", ""),
        (13, 1, None, "1", ""),
        (18, 96, None, "9600", "baud"),
        (19, 1, None, "Remote", ""),
        (21, 1234, 1, "hidden", ""),
        (28, 2, None, "RS-422 bus", ""),
        (28, 1, None, "1", ""),
        (31, 79_999, None, "7.9999", ""),
    ],
)
def test_parameter_text(number: int, raw: int, decimals: int | None, text: str, unit: str) -> None:
    assert parameter_text(PARAMETERS[number], raw, decimals) == text
    assert parameter_unit(PARAMETERS[number]) == unit


def test_presets_of_a_follower_are_ratios() -> None:
    assert parameter_text(PARAMETERS[9], 10_500, None, follower=True) == "1.0500"
    assert parameter_raw(PARAMETERS[9], "1.05", None, follower=True) == 10_500


@for_each("row", [row for row in PARAMETERS.values() if not row.secret])
@for_each("decimals", [0, 1, 4])
def test_parameters_round_trip_at_both_ends(row: Parameter, decimals: int) -> None:
    for raw in (row.minimum, row.maximum):
        assert parameter_raw(row, parameter_text(row, raw, decimals), decimals) == raw


def test_a_choice_may_be_typed_by_its_name() -> None:
    assert parameter_raw(PARAMETERS[19], " remote ", None) == 1


def test_a_speed_cannot_be_typed_before_its_decimals_are_known() -> None:
    with pytest.raises(CallerError, match="decimals"):
        parameter_raw(PARAMETERS[2], "1000", None)


def test_a_baud_rate_is_typed_as_a_number() -> None:
    assert parameter_raw(PARAMETERS[18], "9600", None) == 96
    with pytest.raises(CallerError, match="not a baud rate"):
        parameter_raw(PARAMETERS[18], "9601", None)


def test_a_speed_of_more_decimals_than_a_value_can_have_is_raw() -> None:
    assert speed_text(5, 4) == "0.0005"
    assert speed_text(5, 5) == "5 raw"
    with pytest.raises(CallerError, match="more decimals"):
        speed_raw("5", 5)


@for_each("parameter", PARAMETERS.values())
def test_a_value_outside_of_the_printed_range_is_implausible(parameter: Parameter) -> None:
    number, ends = parameter.number, (parameter.minimum, parameter.maximum)
    assert [plausible_parameter(number, raw) for raw in ends] == list(ends)
    for raw in {max(parameter.minimum - 1, 0), parameter.maximum + 1, 4_294_967_196} - set(ends):
        assert plausible_parameter(number, raw) is None
        words = "hidden" if parameter.secret else f"implausible (raw {raw})"
        assert parameter_text(parameter, raw, 1) == words
    assert plausible_parameter(number, None) is None


def test_a_speed_beyond_the_manual_is_implausible() -> None:
    assert [plausible_speed(raw) for raw in (0, 99_999, 100_000, 4_294_967_196, None)] == [
        0,
        99_999,
        *[None] * 3,
    ]


def test_an_invalid_number_is_not_repeated_where_the_parameter_is_secret() -> None:
    [secret] = [parameter for parameter in PARAMETERS.values() if parameter.secret]
    assert parameter_raw(secret, " 1234 ", None) == 1234
    with pytest.raises(CallerError) as refused:
        parameter_raw(secret, "hunter2", None)
    assert "hunter2" not in str(refused.value)
