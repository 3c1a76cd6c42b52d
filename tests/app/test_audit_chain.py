"""The chain: whatever is changed, removed, added or cut off is named."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.audit.chain import BEGINNING, FIELDS, Head, entry_hash, verify

Log = list[dict[str, Any]]


def written(count: int) -> tuple[Log, Head]:
    log: Log = []
    previous = BEGINNING
    for number in range(1, count + 1):
        entry: dict[str, Any] = {
            **dict.fromkeys(FIELDS),
            "id": number,
            "time": number / 8,
            "what": f"ü{number}",
        }
        previous, entry["previous"] = entry_hash(previous, entry), previous
        entry["hash"] = previous
        log.append(entry)
    return log, Head(count, previous)


def test_a_whole_log() -> None:
    log, head = written(5)
    assert verify(log, head).broken is None
    assert verify([], None).broken is None


@given(st.integers(1, 9), st.sampled_from(FIELDS))
def test_any_changed_field_is_named(number: int, field: str) -> None:
    log, head = written(9)
    log[number - 1][field] = 999
    assert verify(log, head).broken == number


def test_a_changed_entry_that_is_hashed_anew_breaks_the_next() -> None:
    log, head = written(9)
    log[3]["what"] = "nothing happened"
    log[3]["hash"] = entry_hash(log[3]["previous"], log[3])
    verdict = verify(log, head)
    assert (verdict.broken, verdict.fault) == (5, "entry 5 does not continue the one before it")


@pytest.mark.parametrize("number", [1, 5])
def test_a_removed_entry(number: int) -> None:
    log, head = written(9)
    del log[number - 1]
    verdict = verify(log, head)
    assert verdict.broken == number
    assert verdict.fault == f"entry {number} is missing; after {number - 1} comes {number + 1}"


def test_entries_cut_off_at_the_end() -> None:
    log, head = written(9)
    verdict = verify(log[:-2], head)
    assert (verdict.broken, verdict.fault) == (8, "the log ends at entry 7, but 9 were written")


def test_the_whole_log_removed() -> None:
    assert verify([], Head(9, "x")).broken == 1


def test_entries_added_behind_the_head() -> None:
    log, _ = written(9)
    _, head = written(8)
    assert verify(log, head).fault == "entry 9 is not the one that was noted as the newest"


def test_a_head_that_was_removed() -> None:
    assert verify(written(3)[0], None).broken == 3
