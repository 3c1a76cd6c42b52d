"""Refused requests are one line of the log, and what repeats is then counted; a failure of ours is logged
with its traceback once."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from app.core.server.refusal_log import MAX_KEYS, WINDOW_S, ErrorLines, RefusalLog, Repeats, Repetition
from bus.instants import Monotonic

COUNT = 4212
START = Monotonic(1000.0)
SOON = START + WINDOW_S / 2
LATER = START + WINDOW_S
LAST = LATER + WINDOW_S


class Watch:
    """A clock that the test sets."""

    def __init__(self) -> None:
        self.at = Monotonic(1000.0)

    def __call__(self) -> Monotonic:
        return self.at


@pytest.fixture
def errors(caplog: pytest.LogCaptureFixture) -> Iterator[tuple[ErrorLines, Watch]]:
    caplog.set_level(logging.ERROR, "uvicorn.error")  # a server that another test has made may have set it
    watch = Watch()
    handler = ErrorLines(watch)
    loggers = [logging.getLogger(name) for name in ("uvicorn", "asyncio")]
    before = [(logger.handlers, logger.propagate) for logger in loggers]
    handler.install()
    yield handler, watch
    for logger, (handlers, propagate) in zip(loggers, before, strict=True):
        logger.handlers, logger.propagate = handlers, propagate


def test_refused_requests_are_one_line_and_a_number() -> None:
    watch = Watch()
    refused = RefusalLog(watch)
    with capture_logs() as logs:
        for _ in range(COUNT):
            refused.note("10.0.0.7", "malformed", "/" + "x" * 1000)
        refused.sum_up()
        watch.at += WINDOW_S
        refused.sum_up()
    first, number = logs
    assert (first["event"], first["address"], first["reason"]) == ("request refused", "10.0.0.7", "malformed")
    assert len(first["request"]) == 100
    assert number["event"] == "refused 4,211 requests from 10.0.0.7 in the last minute"


def test_an_error_is_logged_with_its_traceback_once(errors: tuple[ErrorLines, Watch]) -> None:
    handler, watch = errors
    logger = logging.getLogger("uvicorn.error")
    with capture_logs() as logs:
        for kind in (KeyError, KeyError, ValueError):
            try:
                raise kind("x")
            except kind:
                logger.exception("Exception in ASGI application\n")
        logging.getLogger("asyncio").error("Fatal error")
        watch.at += WINDOW_S
        handler.sum_up()
    assert [type(entry.get("exc_info")) for entry in logs[:3]] == [KeyError, ValueError, type(None)]
    assert [entry["event"] for entry in logs[2:3]] == ["Fatal error"]
    assert logs[3]["event"].startswith(
        "1 times more in the last minute: Exception in ASGI application KeyError"
    )


def test_what_a_client_causes_is_no_error(errors: tuple[ErrorLines, Watch]) -> None:
    assert errors
    with capture_logs() as logs:
        logging.getLogger("uvicorn.error").error("opening handshake failed", exc_info=ValueError())
        logging.getLogger("uvicorn.error").info("connection open")
    assert logs == []


def test_the_first_is_no_number() -> None:
    repeats = Repeats[str]()
    assert repeats.note("a", "x", START) == Repetition("x", 1, False)
    assert repeats.take_counted(LATER) == []
    assert repeats.note("a", "y", LATER) == Repetition("y", 1, False)


def test_what_follows_is_counted_for_a_minute_and_then_another() -> None:
    repeats = Repeats[int]()
    assert [bool(repeats.note("a", number, START)) for number in range(5)] == [True] + 4 * [False]
    assert repeats.take_counted(SOON) == []
    assert repeats.take_counted(LATER) == [Repetition(4, 4, False)]
    assert repeats.note("a", 5, LATER) is None
    assert repeats.take_counted(LATER) == []
    assert repeats.take_counted(LAST) == [Repetition(5, 1, False)]


def test_each_key_counts_for_itself_and_those_beyond_the_limit_together() -> None:
    repeats = Repeats[str]()
    assert all(repeats.note(number, "", START) for number in range(MAX_KEYS))
    firsts = [repeats.note(f"more {number}", str(number), START) for number in range(50)]
    assert [first for first in firsts if first] == [Repetition("0", 1, True)]
    assert not repeats.note(0, "known", START)
    assert repeats.take_counted(LATER) == [Repetition("known", 1, False), Repetition("49", 49, True)]


def test_at_the_end_everything_is_taken() -> None:
    repeats = Repeats[str]()
    for _ in range(3):
        repeats.note("a", "x", START)
    assert repeats.take_counted(START, everything=True) == [Repetition("x", 2, False)]


@given(st.lists(st.tuples(st.integers(0, 60), st.floats(0, 100)), max_size=60))
def test_nothing_is_lost_or_counted_twice(steps: list[tuple[int, float]]) -> None:
    repeats = Repeats[int](max_keys=20)
    now, noted = START, 0
    for key, step in steps:
        now += step
        first = repeats.note(key, key, now)
        noted += first.count if first else 0
        noted += sum(counted.count for counted in repeats.take_counted(now))
    noted += sum(counted.count for counted in repeats.take_counted(now, everything=True))
    assert noted == len(steps)
