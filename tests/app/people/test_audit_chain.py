"""The chain: whatever is changed, removed, added or cut off is named."""

from __future__ import annotations

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from app.people.audit.entry import (
    BEGINNING,
    FIELDS,
    SITE,
    Head,
    KeyOrigin,
    KeyRing,
    entry_hash,
    new_entry,
    sealed_entry,
    sealed_head,
)
from app.people.audit.proof import AuditVerification, Walk
from tests.for_each import for_each

Log = list[dict[str, Any]]
RING = KeyRing((b"k" * 32,))
STRANGERS_RING = KeyRing((b"s" * 32,))


def verify(
    log: Log, head: Head | None, ring: KeyRing = RING, anchors: dict[int, str] | None = None
) -> AuditVerification:
    walk = Walk(ring, anchors)
    walk.follow(log)
    return walk.end({} if head is None else {SITE: head})


def entry(number: int) -> dict[str, Any]:
    return {**new_entry(kind="x", time=number / 8, what=f"ü{number}"), "id": number}


def written(count: int, ring: KeyRing = RING, after: Log | None = None) -> tuple[Log, Head]:
    """A log of so many entries, those after the first ones sealed with the newest key of ``ring``."""
    log: Log = list(after or [])
    for number in range(len(log) + 1, count + 1):
        log.append(sealed_entry(log[-1]["hash"] if log else BEGINNING, entry(number), ring))
    return log, sealed_head(log[-1], ring)


def written_without_key(count: int) -> tuple[Log, Head]:
    """A log as versions before the key wrote it."""
    log: Log = []
    previous = BEGINNING
    for number in range(1, count + 1):
        row = {**entry(number), "key": "", "seal": "", "previous": previous}
        previous = row["hash"] = entry_hash(previous, row)
        log.append(row)
    return log, Head(count, previous)


def rebuilt(log: Log, since: int) -> tuple[Log, Head]:
    """Return a changed log with all hashes recomputed, as made without the key."""
    for place in range(since - 1, len(log)):
        row = log[place]
        row["previous"] = log[place - 1]["hash"] if place else BEGINNING
        row["hash"] = entry_hash(row["previous"], row)
    return log, Head(len(log), log[-1]["hash"], log[-1]["key"], log[-1]["seal"])


def test_an_intact_log() -> None:
    log, head = written(5)
    assert verify(log, head).broken is None
    assert verify([], None).broken is None


@given(
    st.integers(1, 9), st.sampled_from([*FIELDS, "count", "key", "seal", "previous", "of_a_later_version"])
)
def test_any_changed_field_is_named(number: int, field: str) -> None:
    log, head = written(9)
    log[number - 1][field] = 999 if field not in ("key", "seal", "previous") else "999"
    assert verify(log, head).broken == number


@given(st.integers(1, 9), st.sampled_from([*FIELDS, "count", "of_a_later_version"]))
def test_any_changed_field_of_an_entry_without_a_key_is_named(number: int, field: str) -> None:
    log, head = written_without_key(9)
    log[number - 1][field] = 999
    assert verify(log, head, KeyRing(RING.keys, KeyOrigin(head.id, head.hash))).broken == number


def test_a_changed_entry_that_is_rehashed_breaks_the_next() -> None:
    log, head = written_without_key(9)
    log[3]["what"] = "nothing happened"
    log[3]["hash"] = entry_hash(log[3]["previous"], log[3])
    verdict = verify(log, head, KeyRing(RING.keys, KeyOrigin(head.id, head.hash)))
    assert (verdict.broken, str(verdict.fault)) == (5, "entry 5 does not continue the one before it")


@for_each("number", [1, 5])
def test_a_removed_entry(number: int) -> None:
    log, head = written(9)
    del log[number - 1]
    verdict = verify(log, head)
    assert verdict.broken == number
    assert str(verdict.fault) == f"entry {number} is missing; after {number - 1} comes {number + 1}"


def test_entries_cut_off_at_the_end() -> None:
    log, head = written(9)
    verdict = verify(log[:-2], head)
    assert (verdict.broken, str(verdict.fault)) == (8, "the log ends at entry 7, but 9 were written")


def test_the_complete_log_removed() -> None:
    assert verify([], Head(9, "x")).broken == 1


def test_entries_added_behind_the_head() -> None:
    log, _ = written(9)
    _, head = written(8)
    assert str(verify(log, head).fault) == "entry 9 is not the one that was noted as the newest"


def test_a_head_that_was_removed() -> None:
    assert verify(written(3)[0], None).broken == 3


def test_a_log_that_was_rebuilt_without_the_key() -> None:
    log, _ = written(9)
    log[3]["what"] = "nothing happened"
    log, head = rebuilt(log, 4)
    verdict = verify(log, head)
    assert verdict.broken == 4
    assert str(verdict.fault) == "the seal of entry 4 does not hold: it was not written with the key"


def test_a_log_that_was_rebuilt_with_another_key() -> None:
    log, head = written(9, STRANGERS_RING)
    verdict = verify(log, head)
    assert (verdict.broken, str(verdict.fault)) == (1, "entry 1 is not sealed with a key of the key file")


def test_a_log_that_was_rebuilt_as_if_there_were_no_key_yet() -> None:
    log, head = written_without_key(9)
    assert verify(log, head).broken == 1


def test_a_log_that_was_cut_off_with_its_head_set_back() -> None:
    log, head = written(9)
    seven = log[6]
    verdict = verify(log[:7], Head(7, seven["hash"], seven["key"], head.seal))
    assert str(verdict.fault) == "the log ends at entry 7, but what notes that end is not sealed"


def test_a_seal_of_an_entry_is_none_of_the_head() -> None:
    log, _ = written(9)
    seven = log[6]
    assert verify(log[:7], Head(7, seven["hash"], seven["key"], seven["seal"])).broken == 7


def test_entries_from_before_the_key_are_sealed_by_those_after() -> None:
    old, old_head = written_without_key(5)
    ring = KeyRing(RING.keys, KeyOrigin(5, old_head.hash))
    log, head = written(9, ring, old)
    verdict = verify(log, head, ring)
    assert (verdict.broken, verdict.unsealed) == (None, 5)
    old[2]["what"] = "nothing happened"
    rebuilt(old, 3)
    assert verify(old, Head(5, old[-1]["hash"]), ring).broken == 5
    assert verify(written(9, ring, old)[0], head, ring).broken == 5, "sealed after they were rebuilt"


def test_a_log_that_was_cut_off_before_its_key_was_made() -> None:
    old, old_head = written_without_key(5)
    ring = KeyRing(RING.keys, KeyOrigin(5, old_head.hash))
    assert verify(old, old_head, ring).broken is None
    assert str(verify(old[:3], Head(3, old[2]["hash"]), ring).fault) == (
        "the log ends at entry 3, but 5 were there when the key was made"
    )


def test_a_newer_key_takes_over_and_the_older_one_still_verifies_its_entries() -> None:
    log, _ = written(5)
    ring = RING.with_key(b"n" * 32)
    log, head = written(9, ring, log)
    assert verify(log, head, ring).broken is None
    log, head = written(12, RING, log)
    fault = verify(log, head, ring).fault
    assert str(fault) == "entry 10 is sealed with an older key than the entry before it"


def test_who_knows_an_older_key_cannot_go_back_to_before_the_newer_one() -> None:
    log, _ = written(5)
    ring = RING.with_key(b"n" * 32)
    written(9, ring, log)
    log[4]["what"] = "nothing happened"
    forged, head = written(7, RING, log[:4])
    assert str(verify(forged, head, ring).fault) == (
        "no entry is sealed with the newest key: the log ends before that key"
    )


def test_an_anchored_entry_that_is_another_or_gone() -> None:
    log, head = written(9)
    anchors = {number: log[number - 1]["hash"] for number in (4, 9)}
    assert verify(log, head, RING, anchors).anchored == 9
    shorter, shorter_head = written(6)
    assert str(verify(shorter, shorter_head, RING, anchors).fault) == (
        "the log ends at entry 6, but the anchor names entry 9"
    )
    assert str(verify(log, head, RING, {4: "0" * 64}).fault) == (
        "entry 4 is not the one that the anchor names"
    )


def test_a_walk_stops_at_the_first_broken_entry() -> None:
    log, head = written(9)
    log[3]["what"] = log[6]["what"] = "nothing happened"
    assert verify(log, head).broken == 4
