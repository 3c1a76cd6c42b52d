"""Changes of the line that the log cannot take now: bounded, and what is left out is counted."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from app.errors import StoreError
from app.live import change_recorder
from app.live.change_recorder import ChangeRecorder
from app.live.changes import LineEvent
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
