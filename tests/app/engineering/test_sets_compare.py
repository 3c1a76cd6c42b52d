"""Comparison row by row, and what a difference means."""

from __future__ import annotations

from app.core.messages import Languages
from app.engineering.sets.drift import drift_rows
from app.engineering.sets.model import ParameterRow, UnitRows, compare, differences
from bus.catalogue.parameters import PARAMETERS
from bus.messages import Message, number


def unit(values: dict[int, int | None]) -> UnitRows:
    return UnitRows(1, "Nip", {number: ParameterRow(number, raw) for number, raw in values.items()})


def test_all_forty_rows_are_there_and_unread_ones_are_marked() -> None:
    compared = compare(unit({6: 50}), unit({}))
    assert [row.number for row in compared] == list(PARAMETERS)
    assert {row.kind for row in compared} == {"unknown"}
    assert next(row for row in compared if row.number == 6).right == Message("value_not_known")


def test_a_ramp_explains_what_the_machine_will_do() -> None:
    (row,) = differences(unit({6: 50}), unit({6: 30}))
    assert row.meaning is not None
    assert row.meaning.code == "differs_acceleration"
    assert str(row.meaning) == "accelerates in 3.0 s instead of 5.0 s"
    assert Languages()["de"].t(row.meaning) == "fährt in 3,0 s statt 5,0 s hoch"


def test_each_side_shows_speeds_with_its_decimals() -> None:
    row = next(row for row in differences(unit({3: 1, 9: 1000}), unit({3: 2, 9: 2000})) if row.number == 9)
    assert (row.left, row.right) == (number("100.0"), number("20.00"))


def test_tolerance_in_raw_counts() -> None:
    assert differences(unit({9: 1000}), unit({9: 1002}), tolerance=2) == []
    assert len(differences(unit({9: 1000}), unit({9: 1003}), tolerance=2)) == 1


def test_the_password_is_compared_but_never_shown() -> None:
    (row,) = differences(unit({21: 4711}), unit({21: 815}))
    assert "4711" not in f"{row.left}{row.right}{row.meaning}"
    assert "815" not in f"{row.left}{row.right}{row.meaning}"


def test_a_parameter_that_only_one_of_them_has_is_a_difference() -> None:
    lacking = UnitRows(1, "Nip", {40: ParameterRow(40, None, available=False)})
    (row,) = differences(unit({40: 1}), lacking)
    assert (row.kind, row.right) == ("unavailable", Message("value_not_in_unit"))
    assert differences(lacking, lacking) == []


def test_a_changed_setpoint_is_no_drift() -> None:
    assert [
        row.number for row in drift_rows(unit({20: 100, 37: 9000, 6: 50}), unit({20: 200, 37: 9500, 6: 60}))
    ] == [6]
