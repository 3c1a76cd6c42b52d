"""The TOML file of a parameter set: round trip, masks, and refusals of every kind of nonsense."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.engineering.sets.model import ParameterRow, ParameterSet, UnitRows
from app.engineering.sets.store import DocumentError, read_document, write_document
from bus.catalogue.parameters import PARAMETERS

SECRET = 21


def a_set(values: dict[int, int], name: str = "Nip", comment: str = "") -> ParameterSet:
    rows = {number: ParameterRow(number, raw, True, 1_700_000_000.0) for number, raw in values.items()}
    return ParameterSet(
        "dry-end", 1_700_000_000.0, "anna", "by hand", (UnitRows(3, name, rows),), comment=comment
    )


raws = st.fixed_dictionaries(
    {number: st.integers(row.minimum, row.maximum) for number, row in PARAMETERS.items()}
)
words = st.text(st.characters(exclude_categories=["Cs"]), max_size=40)


@given(values=raws, name=words, comment=words)
def test_a_written_document_is_read_again(values: dict[int, int], name: str, comment: str) -> None:
    read = read_document(write_document(a_set(values, name, comment), with_secrets=True))
    (unit,) = read.units
    assert {number: row.raw for number, row in unit.rows.items()} == values
    assert (unit.unit, unit.name, read.comment, read.bus) == (3, name, comment, "dry-end")


@given(values=raws)
def test_the_password_is_masked_unless_requested(values: dict[int, int]) -> None:
    values[SECRET] = 86420
    text = write_document(a_set(values))
    assert "86420" not in [
        word for line in text.splitlines() if line.startswith("21 ") for word in line.split()
    ]
    assert "masked = true" in text
    assert read_document(text).units[0].raw(SECRET) is None
    assert read_document(write_document(a_set(values), with_secrets=True)).units[0].raw(SECRET) == 86420


def test_one_line_a_parameter_in_its_unit() -> None:
    text = write_document(a_set({3: 1, 6: 50}))
    assert '6 = { name = "Acceleration Ramp Rate", raw = 50, value = "5.0 s" }' in text.splitlines()


def test_a_parameter_that_the_unit_lacks_stays_lacking() -> None:
    rows = {40: ParameterRow(40, None, available=False)}
    text = write_document(ParameterSet("b", 1.0, "anna", "by hand", (UnitRows(1, "A", rows),)))
    assert read_document(text).units[0].rows[40].available is False


GOOD = write_document(a_set({6: 50}))


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("", "not a parameter set"),
        (GOOD[: len(GOOD) - 20], "cut off"),
        (GOOD.replace("version = 1", "version = 2"), "newer version of Lineside"),
        (GOOD.replace("raw = 50", "raw = 10000"), "outside 0 to 9999"),
        (GOOD.replace("raw = 50", 'raw = "fifty"'), "raw"),
        (GOOD.replace("\n6 = ", "\n41 = "), "no parameter '41'"),
        (GOOD.replace("id = 3", "id = 300"), "id"),
        (GOOD.replace("[[unit]]", "[[drive]]").replace("[unit.", "[drive."), "unit"),
        (GOOD + GOOD[GOOD.index("[[unit]]") :], "occurs twice"),
        ('format = "something else"\n', "not a parameter set"),
        (GOOD.replace("\n6 = ", "\n06 = "), "no parameter '06'"),
        (GOOD + "6 = { raw = 51 }\n", "not readable as TOML: .*overwrite"),
        (GOOD + "x = " + "[" * 100_000, "nested too deeply"),
        (GOOD.replace("raw = 50", "raw = " + "9" * 5000), "not readable as TOML"),
        (GOOD.replace("taken_at = ", "taken_at = 0001-01-01T00:00:00 # "), "not a time of reading"),
        (GOOD + "#" * 2_000_000, "too long"),
        (GOOD.replace("raw = 50", "raw = \0 50"), "not readable as TOML"),
    ],
)
def test_nonsense_is_refused_in_words(text: str, error: str) -> None:
    with pytest.raises(DocumentError, match=error) as refused:
        read_document(text, "unit3.toml")
    assert "unit3.toml" in str(refused.value)
