"""What a frame says is filled in by name alone: the text comes from another process."""

from __future__ import annotations

import pytest

from bus.clauses import LONGEST, Clause, filled, in_english


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("unit {unit}: {what}", "unit 3: {unit}"),
        ("{other} {} {0} {", "{other} {} {0} {"),
        ("{unit.__class__} {unit[0]} {unit!r}", "{unit.__class__} {unit[0]} {unit!r}"),
        ("{unit:>9}", "{unit:>9}"),
    ],
)
def test_no_text_is_a_format(text: str, said: str) -> None:
    assert filled(text, {"unit": 3, "what": "{unit}"}) == said


def test_a_meaning_is_no_longer_than_any_is() -> None:
    clause = Clause("{a}" * 100, {"a": "x" * 300})
    assert len(filled(clause.text, clause.values)) == LONGEST
    assert len(in_english([clause] * 30)) == LONGEST
