"""Changes of the line that the log cannot take now: bounded, and what is left out is counted."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from app.errors import StoreError
from app.line.live import change_recorder
from app.line.live.change_recorder import ChangeRecorder, LineEvent
from bus.messages import Message


class Log:
    """An event log whose disk takes nothing until it ``is_writable``."""

    def __init__(self) -> None:
        self.is_writable = False
        self.refused = asyncio.Event()
        self.recorded: list[dict[str, Any]] = []

    async def record(self, **event: Any) -> int:
        if not self.is_writable:
            self.refused.set()
            raise StoreError(Message("store_disk_full"))
        self.recorded.append(event)
        return len(self.recorded)


async def test_the_oldest_are_left_out_and_counted_in_one_event(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(change_recorder, "MAX_WAITING", 5)
    monkeypatch.setattr(change_recorder, "RETRY_AFTER_S", 0.0)
    log = Log()
    recorder = ChangeRecorder(log, "dry-end")  # type: ignore[arg-type]
    following = asyncio.create_task(recorder.follow())
    for unit in range(1, 21):
        recorder.note(LineEvent("run", unit, 5.0, Message("event_run_input"), "on", "off"))
        if unit == 1:
            await log.refused.wait()
    log.is_writable = True
    await recorder.recorded()
    following.cancel()
    assert [event["unit"] for event in log.recorded] == [1, *range(16, 21), None]
    assert (
        str(log.recorded[-1]["what"])
        == "14 changes of the line are missing here: the log could not be written"
    )
    assert log.recorded[-1]["kind"] == "audit"


async def test_a_port_that_comes_and_goes_each_second_is_a_few_events_an_hour(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    log = Log()
    log.is_writable = True
    recorder, now = ChangeRecorder(log, "dry-end"), 0.0  # type: ignore[arg-type]
    monkeypatch.setattr(recorder, "_monotonic", lambda: now)
    following = asyncio.create_task(recorder.follow())
    for second in range(3600):
        now = float(second)
        old, new = ("open", "closed") if second % 2 else ("closed", "open")
        recorder.note(LineEvent("bus", None, now, Message("event_port"), old, new))
        recorder._note_due()
    await recorder.recorded()
    following.cancel()
    assert len(log.recorded) < 80
    assert log.recorded[-1]["new"] == "closed", "the last state is never left out"
    counted = sum(event["message"].params["n"] if event["message"] else 1 for event in log.recorded)
    assert counted == 3600
