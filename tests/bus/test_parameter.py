"""Which values a parameter may be given, and the errors for the others."""

from __future__ import annotations

import pytest

from bus.catalogue.parameter import (
    IllegalValue,
    Parameter,
    check_writable_value,
    danger_of_writing,
    nearest_legal,
)
from bus.errors import CallerError
from bus.messages import parameter_name

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


@pytest.mark.parametrize(("parameter", "raw"), [(RANGE, 1), (RANGE, 6000), (CHOICE, 12), (SECRET, 9999)])
def test_a_legal_value_may_be_written(parameter: Parameter, raw: int) -> None:
    check_writable_value(parameter, raw)


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
