from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.line.live.api.routes import PIECE_BYTES, RecentEvents

BUSES = (None, "dry", "wet")


def recent_events(most_bytes: int = 1_000_000) -> RecentEvents:
    return RecentEvents("a1", most_bytes)


def read(text: bytes) -> list[tuple[str, str, dict[str, object]]]:
    """The id, kind and data of each event, by the rules of WHATWG HTML, 9.2.6."""
    events = []
    for block in text.decode().split("\n\n"):
        fields = dict(line.split(": ", 1) for line in block.split("\n") if line)
        if fields:
            events.append((fields["id"], fields["event"], json.loads(fields["data"])))
    return events


@given(st.lists(st.tuples(st.sampled_from(BUSES), st.booleans()), max_size=60), st.sampled_from(BUSES))
def test_a_reader_gets_each_event_of_its_bus_once_or_learns_of_the_gap(
    steps: list[tuple[str | None, bool]], wanted: str | None
) -> None:
    recent = recent_events(400)
    added: list[tuple[int, str | None]] = []
    number, was_read, since_gap = 0, [], 0
    for bus, reads in steps:
        recent.add("change", bus, {"n": len(added)})
        added.append((len(added), bus))
        if not reads:
            continue
        if not recent.has_all_after(number):
            number, was_read, since_gap = recent.newest, [], len(added)
        while number < recent.newest:
            number, text = recent.after(number, wanted)
            was_read += [data["n"] for _, _, data in read(text)]
    seen = [n for n, bus in added[since_gap:] if wanted is None or bus in (None, wanted)]
    assert was_read == seen[: len(was_read)]
    if recent.has_all_after(number):
        rest = b"".join(text for _, text in _pieces(recent, number, wanted))
        assert was_read + [data["n"] for _, _, data in read(rest)] == seen


def _pieces(recent: RecentEvents, number: int, bus: str | None) -> list[tuple[int, bytes]]:
    pieces = []
    while number < recent.newest:
        number, text = recent.after(number, bus)
        pieces.append((number, text))
    return pieces


def test_an_event_is_one_block_whatever_its_text() -> None:
    recent = recent_events()
    recent.add("alarm", "dry", {"reason": "one\n\ndata: two\r\nid: 7\u2028"})
    assert read(recent.after(0, None)[1]) == [
        ("a1-1", "alarm", {"reason": "one\n\ndata: two\r\nid: 7\u2028"})
    ]
    assert recent.after(0, None)[1].count(b"\n") == 4
    assert b"\r" not in recent.after(0, None)[1]


def test_a_piece_is_bounded() -> None:
    recent = recent_events()
    for _ in range(100):
        recent.add("change", None, {"x": "y" * 2000})
    pieces = _pieces(recent, 0, None)
    assert len(pieces) > 2
    assert max(len(text) for _, text in pieces) < PIECE_BYTES + 2100


def test_the_events_kept_are_bounded() -> None:
    recent = recent_events(1000)
    for _ in range(100):
        recent.add("change", None, {"x": "y" * 90})
    assert not recent.has_all_after(85)
    assert recent.has_all_after(95)
    assert recent.has_all_after(100)
    assert not recent.has_all_after(101)


def test_no_client_resumes_before_an_interruption() -> None:
    recent = recent_events()
    recent.add("change", None, {})
    recent.interrupt()
    assert not recent.has_all_after(1)
    assert recent.has_all_after(recent.newest)


@pytest.mark.parametrize(
    ("id_", "number"), [("a1-7", 7), ("b2-7", None), ("7", None), ("", None), ("a1-", None), ("a1-+7", None)]
)
def test_an_id_of_another_run_or_of_no_run_resumes_nothing(id_: str, number: int | None) -> None:
    assert recent_events().number_of(id_) == number
