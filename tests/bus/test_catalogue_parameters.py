"""The parameter table: as the manual prints it, and sound in itself."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from bus.catalogue.parameter import (
    IllegalValue,
    Parameter,
    Scale,
    check_writable_value,
    danger_of_writing,
    nearest_legal,
)
from bus.catalogue.parameters import NEEDED_TO_SHOW, PARAMETERS
from bus.errors import CallerError
from bus.settings import BAUDS

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
every_row = pytest.mark.parametrize("row", PARAMETERS.values(), ids=lambda row: f"#{row.number}")


@pytest.mark.parametrize("printed", PRINTED, ids=lambda printed: f"#{printed['number']}")
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


def test_maximum_ratio_ends_as_printed() -> None:
    assert PARAMETERS[31].maximum == 0x1387F == 79999


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


@pytest.mark.parametrize(
    ("number", "raw", "nearest"),
    [(3, 5, 4), (3, -1, 0), (15, 0, 1), (31, 80_000, 79_999), (18, 10, 12), (18, 200, 96), (18, 9, 6)],
)
def test_a_value_out_of_range_names_the_nearest(number: int, raw: int, nearest: int) -> None:
    with pytest.raises(IllegalValue, match=f"nearest is {nearest}$") as refused:
        check_writable_value(PARAMETERS[number], raw)
    assert refused.value.nearest == nearest == nearest_legal(PARAMETERS[number], raw)


def test_the_reason_lists_what_a_gapped_range_takes() -> None:
    with pytest.raises(IllegalValue, match="it takes 3, 6, 12, 24, 48 or 96"):
        check_writable_value(PARAMETERS[18], 5)
