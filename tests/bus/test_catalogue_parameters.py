"""The parameter table and its names against the manual, and which values a parameter may be given."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from bus.catalogue import parameters as numbers
from bus.catalogue.parameters import (
    NEEDED_TO_SHOW,
    PARAMETERS,
    IllegalValue,
    Parameter,
    Scale,
    check_writable_value,
    danger_of_writing,
    nearest_legal,
)
from bus.errors import CallerError
from bus.messages import parameter_name
from bus.settings import BAUDS
from tests.for_each import for_each

NAMES = """
MAX_RPM MAX_DISPLAY DECIMALS BASE_RATIO ENCODER_PPR ACCELERATION DECELERATION FOLLOWER_MODE PRESET_SPEED
JUMP_UP JUMP_DOWN AT_SPEED_WINDOW JUMP_MODE FREEZE_MODE DISPLAY_RATE SETUP_DURING_RUN OWN_ADDRESS
BAUD_RATE CONTROL_MODE SPEED_SETPOINT PASSWORD ANALOG_IN_LOW ANALOG_IN_HIGH ANALOG_IN_MODE
ANALOG_IN_RATE ANALOG_IN_TRIM PROTOCOL ANALOG_OUT_SOURCE ANALOG_OUT_LOW ANALOG_OUT_HIGH MAX_RATIO
PRESET_INPUT_MODE REVERSE_INPUT_MODE UP_INPUT_MODE DOWN_INPUT_MODE INSTALLED_OPTION RATIO_SETPOINT
MIN_RATIO DEBOUNCE AT_SPEED_SOURCE
"""
"""In the order of the printed list, which begins with 1."""
NAMED = {name: value for name, value in vars(numbers).items() if name.isupper() and isinstance(value, int)}


def test_every_name_stands_for_its_number() -> None:
    assert {name: number for number, name in enumerate(NAMES.split(), start=1)} == NAMED


RANGE = Parameter(6, "Ramp", "UINT", 1, 6000, "A", "ramps", "how fast")
CHOICE = Parameter(18, "Baud", "UCHR", 3, 96, "A", "link", "speed", allowed=frozenset({3, 12, 96}))
SECRET = Parameter(21, "Password", "UINT", 0, 9999, "A", "link", "opens", secret=True)
FIXED = Parameter(37, "Display", "ULNG", 0, 99999, "A", "readings", "shown", never_writable=True)
LINK = Parameter(
    17, "Address", "UCHR", 1, 255, "A", "link", "who", dangerous="cut off", harmless=frozenset({1})
)


@pytest.mark.parametrize(
    ("parameter", "raw", "nearest"),
    [
        *((RANGE, raw, nearest) for raw, nearest in ((0, 1), (1, 1), (77, 77), (6000, 6000), (6001, 6000))),
        *((CHOICE, raw, nearest) for raw, nearest in ((0, 3), (7, 3), (8, 12), (54, 12), (55, 96), (96, 96))),
    ],
)
def test_the_nearest_legal_value_is_the_smaller_of_two_equally_close(
    parameter: Parameter, raw: int, nearest: int
) -> None:
    assert nearest_legal(parameter, raw) == nearest


def test_a_value_outside_its_range_is_refused_with_the_nearest() -> None:
    with pytest.raises(IllegalValue) as refused:
        check_writable_value(RANGE, 9999)
    assert (
        str(refused.value) == f"{parameter_name(6)} cannot be 9999: it takes 1 to 6000; the nearest is 6000"
    )
    assert refused.value.nearest == 6000


def test_a_value_between_the_legal_ones_is_refused_with_all_of_them() -> None:
    with pytest.raises(IllegalValue, match=r"cannot be 9: it takes 3, 12 or 96; the nearest is 12$"):
        check_writable_value(CHOICE, 9)


def test_the_refusal_of_a_secret_does_not_repeat_it() -> None:
    with pytest.raises(IllegalValue) as refused:
        check_writable_value(SECRET, 12345)
    assert str(refused.value) == f"{parameter_name(21)} takes 0 to 9999"


def test_a_parameter_that_is_never_written_takes_no_value() -> None:
    with pytest.raises(CallerError, match="cannot be changed over the bus") as refused:
        check_writable_value(FIXED, 5)
    assert not isinstance(refused.value, IllegalValue)


def test_a_write_is_dangerous_by_its_value() -> None:
    assert danger_of_writing(LINK, 2) == "cut off"
    assert danger_of_writing(LINK, 1) == ""
    assert danger_of_writing(RANGE, 2) == ""


PRINTED: list[dict[str, Any]] = json.loads(
    (Path(__file__).parent.parent / "vectors" / "manual_parameters.json").read_text()
)
LARGEST = {"UCHR": 0xFF, "UINT": 0xFFFF, "ULNG": 0xFFFFFFFF}
GROUPS = {
    "Speed and display",
    "Ramps",
    "Mode",
    "Ratio",
    "Presets and jumps",
    "Inputs",
    "Analog input",
    "Analog output",
    "Link",
    "Operator",
}
every_row = for_each("row", PARAMETERS.values())


@for_each("printed", PRINTED)
def test_as_printed_in_section_4(printed: dict[str, Any]) -> None:
    row = PARAMETERS[printed["number"]]
    assert (row.name, row.type) == (printed["name"], printed["type"])
    assert (row.minimum, row.maximum) == (printed["minimum"], printed["maximum"])


def test_the_transcription_agrees_with_what_it_transcribes() -> None:
    for printed in PRINTED:
        low, high = printed["printed"].split(" ... ")
        assert (int(low, 16), int(high.rstrip("h"), 16)) == (printed["minimum"], printed["maximum"])


def test_forty_rows_in_order() -> None:
    assert list(PARAMETERS) == list(range(1, 41)) == [row.number for row in PARAMETERS.values()]


@every_row
def test_a_row_is_sound(row: Parameter) -> None:
    assert 0 <= row.minimum < row.maximum <= LARGEST[row.type]
    assert row.group in GROUPS
    assert row.meaning.endswith(".")
    assert all(row.minimum <= choice <= row.maximum for choice in row.choices)
    assert row.harmless <= set(range(row.minimum, row.maximum + 1))
    if row.evidence == "U":
        assert row.scale is Scale.PLAIN


def test_undocumented_choices_are_not_named() -> None:
    named = {number: sorted(row.choices) for number, row in PARAMETERS.items() if row.choices}
    assert named == {8: [0, 1, 2], 16: [0, 1], 19: [0, 1, 2], 26: [0, 1], 28: [2]}


def test_access() -> None:
    def numbers(field: str) -> list[int]:
        return [row.number for row in PARAMETERS.values() if getattr(row, field)]

    assert numbers("never_writable") == [17]
    assert numbers("dangerous") == [18, 19, 27]
    assert numbers("secret") == [21]
    assert numbers("not_while_running") == [8]
    assert PARAMETERS[18].allowed == {baud // 100 for baud in BAUDS}


def test_scales_of_protocol_md() -> None:
    def numbers(scale: Scale) -> list[int]:
        return [row.number for row in PARAMETERS.values() if row.scale is scale]

    assert numbers(Scale.RATIO) == [4, 31, 37, 38]
    assert numbers(Scale.TENTHS) == [6, 7]
    assert numbers(Scale.SPEED_OR_RATIO) == [9, 10, 11]
    assert numbers(Scale.SPEED) == [2, 12, 20]
    assert numbers(Scale.BAUD) == [18]


def test_needed_to_show() -> None:
    assert NEEDED_TO_SHOW == (1, 2, 3, 8, 12, 22, 23, 28, 29, 30)


def test_going_remote_is_harmless() -> None:
    assert danger_of_writing(PARAMETERS[19], 0).endswith("keypad")
    assert danger_of_writing(PARAMETERS[19], 1) == ""
    assert danger_of_writing(PARAMETERS[27], 1) != ""
    assert danger_of_writing(PARAMETERS[6], 50) == ""


@every_row
def test_both_ends_of_the_range_may_be_written(row: Parameter) -> None:
    if row.never_writable:
        with pytest.raises(CallerError, match="cannot be changed over the bus"):
            check_writable_value(row, row.minimum)
        return
    check_writable_value(row, row.minimum)
    check_writable_value(row, row.maximum)
