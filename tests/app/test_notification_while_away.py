"""Alarms of the time without the database: in the journal once and in order, and notified once."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from app.alarms.acts import ACKNOWLEDGE
from app.alarms.monitor.bus_alarms import BusAlarms
from app.alarms.monitor.line_alarms import LineAlarms
from app.notification.outbox.notifier import AlarmNotifier
from app.notification.service import Notification
from app.web.admission.access import Person, Role
from tests.app.away_store import AwayDatabase, away_house
from tests.app.notification_servers import PlayedMailServer, PlayedReceiver, mail_server, receiver
from tests.app.played_line import BUS, played_line
from tests.app.test_notification_path import Path_, notify

ESTOP = f"{BUS}.1.estop_active"
ANNA = Person("anna", Role.OPERATOR, "demo")


@asynccontextmanager
async def running(
    folder: Path, mail: PlayedMailServer, hooks: PlayedReceiver
) -> AsyncIterator[tuple[Path_, AwayDatabase]]:
    async with away_house(folder, notify=notify(mail, hooks, folder)) as (house, database):
        await played_line(house.services)
        house.services.buses[BUS][BusAlarms].tick()
        path = Path_(house, mail, hooks)
        await path.advance()
        yield path, database
        if database.is_away:
            await database.come_back()


@pytest.fixture
async def servers() -> AsyncIterator[tuple[PlayedMailServer, PlayedReceiver]]:
    async with mail_server() as mail, receiver() as hooks:
        yield mail, hooks


async def transitions(path: Path_) -> list[tuple[str, str]]:
    found = await path.house.services[LineAlarms].store.journal(50, alarm=ESTOP)
    return [(entry.trigger, entry.after) for entry in reversed(found)]


async def notices(database: AwayDatabase) -> list[tuple[str, str]]:
    """Of the e-stop: what was or will be sent, and how far it is.

    On a slow machine the alarm of the database itself comes in between, and joins a message.
    """
    query = (
        "SELECT item.kind, coalesce(delivery.state, 'waiting') FROM notification_item AS item "
        "LEFT JOIN notification_delivery AS delivery ON delivery.id = item.delivery "
        "WHERE item.alarm = ? ORDER BY item.kind"
    )
    rows = await database.read(lambda connection: connection.execute(query, (ESTOP,)).fetchall())
    return [tuple(row) for row in rows]


async def test_an_alarm_of_the_time_without_the_database(
    tmp_path: Path, servers: tuple[PlayedMailServer, PlayedReceiver]
) -> None:
    async with running(tmp_path, *servers) as (path, database):
        alarms = path.house.services[LineAlarms]
        database.leave()
        await path.estop(active=True)
        assert (await path.mail.mail())["Subject"] == "urgent: Unwind · Emergency stop"
        assert (await path.hooks.body())["alarm"]["code"] == "estop_active"
        await _sent(path)
        [alarm] = [each for each in alarms.present() if each.definition.code == "estop_active"]
        await alarms.act(ANNA, ACKNOWLEDGE, alarm.id)
        assert alarm.facts.state == "ack_active"
        await path.estop(active=False)
        assert (await path.hooks.body(2))["kind"] == "clear"
        await path.mail.containing("Cleared: Unwind · Emergency stop")
        await _sent(path)
        await database.come_back()
        assert await transitions(path) == [
            ("rise", "unack_active"),
            ("acknowledge", "ack_active"),
            ("clear", "normal"),
        ]
        [event] = await path.house.events("alarm")
        assert (event["who"], event["entered_at"] is not None) == ("anna", True)
        await path.advance()
        await path.advance()
        sent = [("alarm", "delivered")] * 2 + [("clear", "delivered")] * 2
        assert await notices(database) == sent, "what was sent is not sent again"


async def test_an_alarm_that_stands_is_not_notified_again_after_a_restart(
    tmp_path: Path, servers: tuple[PlayedMailServer, PlayedReceiver]
) -> None:
    mail, hooks = servers
    async with running(tmp_path, *servers) as (path, database):
        database.leave()
        await path.estop(active=True)
        await mail.mail()
        await hooks.body()
        await _sent(path)
    # The server has ended without the database; the next one brings all of it there first.
    async with away_house(tmp_path, notify=notify(mail, hooks, tmp_path)) as (house, reached):
        notifier = house.services.buses[BUS][AlarmNotifier]
        await notifier.advance()
        await notifier.notify_standing()
        assert await notices(reached) == [("alarm", "delivered")] * 2


async def _sent(path: Path_) -> None:
    async with asyncio.timeout(20):
        for task in tuple(path.house.services[Notification].away._serving):
            await task
