"""RefusalLog requests are one line of the log; a failure of ours is logged with its traceback once."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import pytest
from structlog.testing import capture_logs

from app.core.server.admission.refusal_log import ErrorLines, RefusalLog
from app.core.server.admission.repeats import WINDOW_S
from bus.instants import Monotonic

COUNT = 4212


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
