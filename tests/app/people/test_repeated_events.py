"""What strangers can cause as often as they like makes a bounded number of events, and none of it is lost."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from app.core.database import Database
from app.core.server.refusal_log import WINDOW_S
from app.people.audit.log import MANY, MAX_KEYS, EventLog, Filter, RepeatedEvents
from tests.app.complete_app import complete_app


class Scene:
    """A log and its clock."""

    def __init__(self, folder: Path) -> None:
        self.now = 1000.0
        self.database = Database(folder / "lineside.db")
        self.events = EventLog(self.database, lambda: self.now)
        self.events.repeated = RepeatedEvents(self.events.record, lambda: self.now, lambda: self.now)

    async def refuse(self, times: int = 1, origin: str = "192.0.2.7") -> None:
        for _ in range(times):
            await self.events.repeated.count(
                "login_refused", "login refused", who="unknown name", origin=origin
            )

    async def item(self) -> list[tuple[str, int, float]]:
        """Origin, count and time of each event, oldest first."""
        found, _ = await self.events.page(Filter(kind="login_refused"), 1000)
        return [(event["origin"], event["count"] or 1, event["time"]) for event in reversed(found)]


@pytest.fixture
async def scene(tmp_path: Path) -> AsyncIterator[Scene]:
    made = Scene(tmp_path)
    yield made
    made.database.close()


async def test_the_first_is_an_event_at_once_and_the_rest_one_a_minute(scene: Scene) -> None:
    await scene.refuse(500)
    await scene.events.repeated.record_due()
    assert await scene.item() == [("192.0.2.7", 1, 1000.0)]
    scene.now += 30
    await scene.refuse()
    scene.now += WINDOW_S
    await scene.events.repeated.record_due()
    assert await scene.item() == [("192.0.2.7", 1, 1000.0), ("192.0.2.7", 500, 1030.0)]


async def test_who_goes_on_has_one_event_a_minute(scene: Scene) -> None:
    for _ in range(10):
        await scene.refuse(100)
        scene.now += WINDOW_S
        await scene.events.repeated.record_due()
    item = await scene.item()
    assert len(item) == 11
    assert sum(count for _, count, _ in item) == 1000


async def test_who_comes_back_later_is_an_event_at_once_again(scene: Scene) -> None:
    await scene.refuse()
    scene.now += WINDOW_S
    await scene.events.repeated.record_due()
    scene.now += WINDOW_S
    await scene.refuse()
    assert len(await scene.item()) == 2


async def test_the_end_of_the_server_loses_no_count(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        for _ in range(7):
            await house.services[EventLog].repeated.count("login_refused", "login refused")
    async with complete_app(tmp_path) as house:
        assert [event["count"] for event in await house.events("login_refused")] == [6, None]


async def test_many_addresses_are_distinguished_only_so_far(scene: Scene) -> None:
    for number in range(1000):
        await scene.refuse(2, origin=f"2001:db8::{number:x}")
    scene.now += WINDOW_S
    await scene.events.repeated.record_due()
    item = await scene.item()
    assert len(item) == 2 * MAX_KEYS + 2
    assert sum(count for _, count, _ in item) == 2000
    assert (str(MANY), 2 * (1000 - MAX_KEYS) - 1) in [(origin, count) for origin, count, _ in item]


async def test_the_count_is_part_of_the_chain(scene: Scene) -> None:
    await scene.refuse(5)
    await scene.events.repeated.record_due(everything=True)
    await scene.database.write(lambda connection: connection.execute("DROP TRIGGER events_stay_as_written"))
    assert (await scene.events.proof.verify()).broken is None
    await scene.database.write(
        lambda connection: connection.execute("UPDATE events SET count = 2 WHERE count = 4")
    )
    assert (await scene.events.proof.verify()).broken == 2
