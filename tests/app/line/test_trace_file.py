"""The trace file: a line is what it was made of."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.line.commands.trace_file import is_trace_line, parse_trace_line, trace_line
from bus.contract import Direction, Frame
from bus.errors import CallerError
from bus.messages import term

LINE = "2026-11-21T02:01:33.123456+00:00\tout\t10 02 04 81 10 03 7B\tunit 4: read speed and status"


def test_a_line() -> None:
    frame = Frame(
        1795226493.123456, "out", bytes.fromhex("10020481 10037B"), [term("unit 4: read speed and status")]
    )
    assert trace_line(frame) == LINE
    assert is_trace_line(LINE)


@given(
    st.integers(0, 4_000_000_000_000_000),
    st.sampled_from(["out", "in"]),
    st.binary(max_size=40),
    st.text(max_size=40),
)
def test_lines_round_trip(microseconds: int, direction: Direction, data: bytes, meaning: str) -> None:
    at = microseconds / 1e6
    line = trace_line(Frame(at, direction, data, [term(meaning)]))
    assert "\n" not in line
    assert is_trace_line(line)
    back = parse_trace_line(line + "\n")
    assert back.at == pytest.approx(at, abs=2e-6)
    assert (back.direction, back.data, back.meaning) == (direction, data, " ".join(meaning.split()))


@pytest.mark.parametrize(
    "line",
    ["", "10 02 04", LINE.replace("out", "up"), LINE.replace("10 02", "1x 02"), LINE.replace("2026", "when")],
)
def test_texts_that_are_no_line(line: str) -> None:
    with pytest.raises(CallerError, match="not a line of a trace"):
        parse_trace_line(line)


def test_hex_is_not_taken_for_a_trace() -> None:
    assert not is_trace_line("10 02 04\t81 10 03 7B")
