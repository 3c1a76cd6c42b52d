"""Where an update goes: the live state, the history, the events."""

from __future__ import annotations

from datetime import datetime
from typing import Any

import pytest
from msgspec import structs

from app.errors import StoreError
from app.line.live.change_recorder import FEW
from app.people.audit.log import Filter
from bus.contract import Batch, BusLink
from bus.messages import Message, term
from tests.app.complete_app import House
from tests.app.conftest import Kept
from tests.app.fake_worker import HEALTHY, hello, reading, snapshot, until


async def events(site: House, count: int) -> list[dict[str, Any]]:
    """Oldest first, once there are so many."""
    while True:
        found = (await site.http().get("/api/v1/events")).json()["events"]
        found = [event for event in found if event["kind"] != "server"]
        if len(found) >= count:
            return list(reversed(found))


async def test_what_happens_on_the_line_is_written_down_in_order(site: House) -> None:
    worker = await site.worker()
    await worker.update(reading(1))
    local = reading(1, outputs=0)
    await worker.update(local)
    await worker.update(reading(1, outputs=0, inputs=HEALTHY | 1))
    await worker.update(BusLink(at=1.0, link="open"))
    await worker.update(BusLink(at=1.0, link="closed", cause=term("unplugged")))
    found = await events(site, 4)
    assert [(event["kind"], event["unit"], event["old"], event["new"]) for event in found] == [
        ("worker", None, "", "connected"),
        ("mode", 1, "REMOTE", "LOCAL"),
        ("run", 1, "off", "on"),
        ("bus", None, "open", "closed"),
    ]
    assert "unplugged" in found[-1]["what"]
    assert abs(datetime.fromisoformat(found[1]["time"]).timestamp() - local.at) < 0.001
    await site.recorder.recorded()


async def test_workers_come_go_and_come_back(site: House) -> None:
    worker = await site.worker()
    await worker.leave()
    await until(lambda: not site.live.worker_connected, "the loss")
    await site.worker(hello())
    found = await events(site, 3)
    assert "started" in found[0]["what"]
    assert "not connected" in found[1]["what"]
    assert "is back" in found[2]["what"]


async def test_a_worker_that_ran_before_the_server_has_not_started(site: House) -> None:
    """The server was restarted, and the worker of another computer was not."""
    first = hello()
    await site.worker(structs.replace(first, started_at=first.sent_at - 3600))
    assert "is back" in (await events(site, 1))[0]["what"]


async def test_what_happened_while_the_app_was_away_is_written_down_too(site: House, kept: Kept) -> None:
    worker = await site.worker()
    await worker.update(reading(1))
    await until(lambda: len(kept.readings) == 1, "the first reading")
    await worker.leave()
    back = await site.worker(hello(), snapshot(seq=3))
    for seq, outputs in ((2, 0), (3, 0b0100_0000)):
        updates = [reading(1, outputs=outputs)]
        await back.send(Batch(seq=seq, sent_at=0.0, updates=list(updates), live=False))
    found = [event for event in await events(site, 5) if event["kind"] == "mode"]
    assert [event["new"] for event in found] == ["LOCAL", "REMOTE"]
    assert len(kept.readings) == 3


async def test_a_stepped_clock_is_written_down(site: House) -> None:
    site.pipeline.clock_stepped(-3600.0, 5.0)
    found = await events(site, 1)
    assert found[0]["kind"] == "clock"
    assert "-3600" in found[0]["what"]


async def test_events_that_cannot_be_written_now_are_written_later(
    site: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    record, refused = site.log.record, 0

    async def full(**_: Any) -> int:
        nonlocal refused
        refused += 1
        raise StoreError(Message.of("system_error", error="the disk is full"))

    monkeypatch.setattr("app.line.live.change_recorder.RETRY_AFTER_S", 0.01)
    monkeypatch.setattr(site.log, "record", full)
    worker = await site.worker()
    await worker.update(reading(1))
    await worker.update(reading(1, outputs=0))
    await until(lambda: refused >= 3, "some tries")
    monkeypatch.setattr(site.log, "record", record)
    assert [event["kind"] for event in await events(site, 2)] == ["worker", "mode"]


async def test_a_port_that_flaps_indefinitely_is_few_events_with_a_count(site: House) -> None:
    """Four a second came into a log that is kept for good."""
    for number in range(500):
        links: list[BusLink] = [BusLink(1.0, "open"), BusLink(1.0, "closed", f"closed {number}")]
        site.pipeline.batch(links, live=True)
    await site.recorder.recorded()
    found, _ = await site.log.page(Filter(kind="bus"), 100)
    assert len(found) == FEW + 1
    last = found[0]
    assert (last["what"], last["new"]) == ("port closed: closed 499", "closed")
    assert last["message"].startswith(f"the last of {999 - FEW} events within ")


async def test_a_summary_is_recorded_without_anything_new(
    site: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    later = 0.0
    monkeypatch.setattr(site.recorder, "_monotonic", lambda: later)
    for _ in range(10):
        site.pipeline.batch([BusLink(1.0, "open"), BusLink(1.0, "closed")], live=True)
    later = 3600.0
    await events(site, FEW + 1)
