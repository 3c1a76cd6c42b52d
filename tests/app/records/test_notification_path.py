"""From an alarm to its mail and its webhook: the complete app with real servers."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Collection
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from app.core.database import Database, StoreConnection
from app.core.web.access import Person, Role
from app.errors import StoreError
from app.line.alarms.acts import ACKNOWLEDGE
from app.line.alarms.bus_alarms import BusAlarms
from app.line.alarms.line_alarms import LineAlarms
from app.line.alarms.own_alarms import OwnAlarmBook
from app.line.live.bus_live import LiveState
from app.people.audit.log import EventLog
from app.records.notification.outbox import NotificationDelivery, NotificationOutbox, OutboxItem
from app.records.notification.service import AlarmNotifier, Notification
from app.records.notification.settings import NotifySettings
from bus.contract import Reading
from bus.instants import UnixTime
from bus.messages import Message
from tests.app.complete_app import House, complete_app
from tests.app.notification_servers import PlayedMailServer, PlayedReceiver, mail_server, receiver
from tests.app.played_line import BUS, HEALTHY, REMOTE, estop, played_line

LIMIT_S = 60.0


@dataclass
class Path_:
    """The app, and where its notifications go."""

    house: House
    mail: PlayedMailServer
    hooks: PlayedReceiver

    async def estop(self, *, active: bool, unit: int = 1) -> None:
        estop(self.house.services, active=active, unit=unit)
        await self.advance()

    async def advance(self) -> None:
        """Bring the journal to disk and follow it."""
        await self.house.services[LineAlarms].write()
        await self.house.services[AlarmNotifier].advance()

    async def events(self, state: str) -> list[dict[str, Any]]:
        found = await self.house.events("notification")
        return [event for event in found if f"Notification {state}" in str(event["what"])]

    async def ended(self, state: str, count: int = 1) -> list[NotificationDelivery]:
        """The deliveries in a state, once there are so many."""
        notification = self.house.services[Notification]
        async with asyncio.timeout(LIMIT_S):
            while True:
                attempted = notification.dispatcher.attempted
                found = [
                    each for each in await notification.outbox.deliveries(100, None) if each.state == state
                ]
                if len(found) >= count:
                    return found
                await attempted.wait()


def notify(mail: PlayedMailServer, hooks: PlayedReceiver, folder: Path, **more: Any) -> NotifySettings:
    key = folder / "hook.key"
    key.write_text("key")
    smtp = {"host": "127.0.0.1", "port": mail.port, "security": "none", "sender": "lineside@plant"}
    known = {
        "dashboard_url": "https://plant.example",
        "smtp": {**smtp, "to": ["duty@plant"]},
        "webhook": [{"url": hooks.url, "secret_file": key, "priorities": ["urgent"]}],
    }
    return NotifySettings.model_validate({**known, **more})


@asynccontextmanager
async def running(
    folder: Path, mail: PlayedMailServer, hooks: PlayedReceiver, **more: Any
) -> AsyncIterator[Path_]:
    async with complete_app(folder, notify=notify(mail, hooks, folder, **more)) as house:
        await played_line(house.services)
        house.services.buses[BUS][BusAlarms].tick()
        yield Path_(house, mail, hooks)


@pytest.fixture
async def servers() -> AsyncIterator[tuple[PlayedMailServer, PlayedReceiver]]:
    async with mail_server() as mail, receiver() as hooks:
        yield mail, hooks


@pytest.fixture
async def path(tmp_path: Path, servers: tuple[PlayedMailServer, PlayedReceiver]) -> AsyncIterator[Path_]:
    async with running(tmp_path, *servers) as path:
        yield path


async def test_an_alarm_reaches_people_and_programs_and_so_does_its_end(path: Path_) -> None:
    await path.estop(active=True)
    mail, hook = await path.mail.mail(), await path.hooks.body()
    assert mail["Subject"] == "urgent: Unwind · Emergency stop"
    text = mail.get_content()
    assert "Response: Go to the machine" in text
    assert "https://plant.example/notifications/acknowledge?alarm=dry-end.1.estop_active.1" in text
    assert (hook["kind"], hook["alarm"]["state"], hook["alarm"]["code"]) == (
        "alarm",
        "unack_active",
        "estop_active",
    )
    await path.estop(active=False)
    mail, hook = await path.mail.mail(2), await path.hooks.body(2)
    assert mail["Subject"] == "Cleared: Unwind · Emergency stop"
    assert (hook["kind"], hook["alarm"]["state"], hook["alarm"]["active"]) == ("clear", "rtn_unack", False)
    await path.ended("delivered", 4)
    events = await path.house.events("notification")
    assert [event["unit"] for event in events] == [1] * 4
    assert {event["what"] for event in events} >= {"Notification delivered to duty@plant: Emergency stop"}


async def test_an_alarm_at_once_after_the_first_start_is_notified(
    tmp_path: Path, servers: tuple[PlayedMailServer, PlayedReceiver], monkeypatch: pytest.MonkeyPatch
) -> None:
    load = NotificationOutbox.followed

    async def load_slowly(outbox: NotificationOutbox) -> Any:
        await asyncio.sleep(0.1)
        return await load(outbox)

    monkeypatch.setattr(NotificationOutbox, "followed", load_slowly)
    async with running(tmp_path, *servers) as path:
        estop(path.house.services, active=True)
        await path.house.services[LineAlarms].write()
        assert (await path.mail.mail())["Subject"] == "urgent: Unwind · Emergency stop"


async def test_the_end_of_an_alarm_that_is_removed_reaches_who_was_notified(path: Path_) -> None:
    services, anna = path.house.services, Person("anna", Role.ENGINEER, "session")
    written = {"name": "Stopped", "bus": BUS, "unit": 1, "value": "run", "state": "off", "priority": "urgent"}
    own = await services[OwnAlarmBook].add(anna, written)
    live = services[LiveState].buses[BUS]
    live.apply([Reading(1, UnixTime(time.time()), 0, 0, 0, REMOTE, HEALTHY)])
    await path.advance()
    mail = await path.mail.mail()
    assert mail["Subject"] == "urgent: Unwind · Stopped"
    await services[OwnAlarmBook].remove(anna, own.key, own.version, "no longer needed")
    await path.advance()
    mail, hook = await path.mail.mail(2), await path.hooks.body(2)
    assert mail["Subject"] == "Cleared: Unwind · Stopped"
    assert hook["kind"] == "clear"


async def test_nothing_is_notified_twice(path: Path_) -> None:
    await path.estop(active=True)
    for _ in range(3):
        await path.advance()
    await path.ended("delivered", 2)
    notifier = path.house.services[AlarmNotifier]
    await notifier.load()
    notifier._cursor = 0  # as after a crash between reading the journal and writing the outbox
    await notifier.advance()
    assert len(await path.ended("delivered", 2)) == 2
    assert await path.house.services[Notification].outbox.waiting() == {}


async def test_the_places_that_an_earlier_version_stored_for_each_bus_are_one(path: Path_) -> None:
    await path.estop(active=True)
    await path.ended("delivered", 2)
    database, notifier = path.house.services[Database], path.house.services[AlarmNotifier]

    def write(connection: StoreConnection) -> None:
        connection.execute("UPDATE notification_cursor SET source = ?", (BUS,))
        connection.execute("INSERT INTO notification_cursor VALUES ('_', 0)")
        connection.execute("UPDATE notification_episode SET source = ?", (BUS,))

    database.write_now(write)
    await notifier.load()
    await path.estop(active=True, unit=2)
    assert [len(await path.ended("delivered", 4)), len(path.mail.mails)] == [4, 2]
    stored = await database.read(
        lambda connection: connection.execute("SELECT source FROM notification_cursor").fetchall()
    )
    assert [row["source"] for row in stored] == [""]


async def test_a_refused_message_is_tried_again_and_fails_as_an_alarm(
    path: Path_, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.records.notification.dispatcher.retry_after_s", lambda _: 0.0)
    path.mail.replies["RCPT"] = "451 later"
    await path.estop(active=True)
    site = path.house.services[LineAlarms].site
    async with asyncio.timeout(LIMIT_S):
        while not path.house.services[Notification].dispatcher.failing:
            await path.house.services[Notification].dispatcher.attempted.wait()
    site.tick()
    alarm = site.list.alarms["_.notification_failed"]
    assert alarm.facts.active
    del path.mail.replies["RCPT"]
    mail = await path.mail.mail()
    assert mail["Subject"].startswith("urgent: Unwind")
    await path.ended("delivered", 2)
    site.tick()
    assert not alarm.facts.active
    (failure,) = await path.events("not delivered")
    assert "451 later" in failure["message"]
    assert len(await path.events("delivered")) == 2


async def test_an_attempt_that_a_crash_interrupted_is_repeated_with_its_id(
    tmp_path: Path, servers: tuple[PlayedMailServer, PlayedReceiver]
) -> None:
    async with running(tmp_path, *servers, smtp=None, webhook=[]) as path:
        store = path.house.services[Notification].outbox
        now = UnixTime(time.time())
        await store.add([OutboxItem("test:crash", "mail:duty@plant", "test", now)])
        ((item, _),) = (await store.load_of("mail:duty@plant", now, collects=True)).items
        begun = await store.begin("mail:duty@plant", [item], now)
    async with running(tmp_path, *servers) as path:
        mail = await path.mail.mail()
        assert mail["Message-ID"] == f"<{begun.message_id}@plant>"
        ((delivery),) = await path.ended("delivered")
        assert delivery.id == begun.id


async def test_a_result_that_cannot_be_stored_sends_nothing_twice(
    path: Path_, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.records.notification.dispatcher.STORE_RETRY_S", 0.0)
    record, failures = path.house.services[EventLog].record, [StoreError(Message("store_closed"))] * 3

    async def fails_thrice(**event: Any) -> int:
        if failures:
            raise failures.pop()
        return await record(**event)

    monkeypatch.setattr(path.house.services[EventLog], "record", fails_thrice)
    await path.estop(active=True)
    await path.ended("delivered", 2)
    assert (len(path.mail.mails), len(path.hooks.received)) == (1, 1)


async def test_a_flood_is_one_message_for_people_and_each_for_programs(
    tmp_path: Path, servers: tuple[PlayedMailServer, PlayedReceiver]
) -> None:
    settings = {**dict(notify(*servers, tmp_path, flood=1)), "digest_s": 0.0}
    async with complete_app(tmp_path, notify=NotifySettings.model_construct(**settings)) as house:
        await played_line(house.services)
        path = Path_(house, *servers)
        await path.estop(active=True)
        delivered = await path.ended("delivered", 2)
        store = house.services[Notification].outbox
        items = [replace(each.items[0], key=f"more:{n}") for each in delivered for n in range(4)]
        await store.add(items)
        house.services[Notification].dispatcher.wake()
        assert {(await path.hooks.body(count))["kind"] for count in range(1, 6)} == {"alarm"}
        digest = await path.mail.mail(2)
        assert digest["Subject"] == "Mill 7: 4 messages, 4 of them urgent"
        assert digest.get_content().count("urgent: Unwind · Emergency stop") == 4


async def test_each_address_gets_one_heartbeat_a_day(
    tmp_path: Path, servers: tuple[PlayedMailServer, PlayedReceiver], monkeypatch: pytest.MonkeyPatch
) -> None:
    checked_again = asyncio.Event()

    def due(*_: object) -> str:
        checked_again.set()
        return "2026-11-22"

    monkeypatch.setattr("app.records.notification.dispatcher.heartbeat_due", due)
    monkeypatch.setattr("app.records.notification.dispatcher.HEARTBEAT_CHECK_S", 0.01)
    async with running(tmp_path, *servers) as path:
        assert (await path.mail.mail())["Subject"] == "Mill 7: notification works"
        assert (await path.hooks.body())["kind"] == "heartbeat"
        delivered = await path.ended("delivered", 2)
        checked_again.clear()
        async with asyncio.timeout(LIMIT_S):
            await checked_again.wait()
        await path.house.services[Notification].dispatcher.test(
            next(iter(path.house.services[Notification].plan.endpoints.values()))
        )
        heartbeats = [each for each in await path.ended("delivered", 3) if each.items[0].kind == "heartbeat"]
        assert [each.id for each in heartbeats] == [each.id for each in delivered]


async def test_an_address_that_was_removed_gets_nothing_more(
    tmp_path: Path, servers: tuple[PlayedMailServer, PlayedReceiver]
) -> None:
    servers[0].replies["RCPT"] = "451 later"
    async with running(tmp_path, *servers) as path:
        await path.estop(active=True)
        await path.ended("retrying")
    async with running(tmp_path, *servers, smtp=None, group=[], rule=[]) as path:
        (canceled,) = await path.ended("canceled")
        assert canceled.endpoint == "mail:duty@plant"


async def test_a_fault_of_one_address_leaves_the_others(path: Path_, monkeypatch: pytest.MonkeyPatch) -> None:
    outbox = path.house.services[Notification].outbox
    load_of = outbox.load_of

    async def fails_for_mail(endpoint: str, *given: Any, **more: Any) -> Any:
        if endpoint.startswith("mail"):
            raise RuntimeError("damaged")
        return await load_of(endpoint, *given, **more)

    monkeypatch.setattr(outbox, "load_of", fails_for_mail)
    await path.estop(active=True)
    assert (await path.hooks.body())["kind"] == "alarm"


async def test_no_secret_is_in_the_events_or_the_store(path: Path_) -> None:
    await path.estop(active=True)
    await path.ended("delivered", 2)
    assert path.house.services.settings.server.data.exists()
    database = path.house.services.settings.server.store
    stored = b"".join(each.read_bytes() for each in database.parent.iterdir() if each.is_file())
    assert b"Emergency stop" in stored
    assert b"hooks/s3cret" not in stored
    viewer = await path.house.program(Role.VIEWER)
    events = (await viewer.get("/api/v1/events", params={"limit": 100})).text
    assert "s3cret" not in events


async def stand(folder: Path, *, settled: bool = False, **notified: NotifySettings) -> None:
    """Two e-stops stand when the server ends; ``settled``: one is acknowledged, the other has cleared."""
    async with complete_app(folder, **notified) as house:
        await played_line(house.services)
        alarms, live = house.services[LineAlarms], house.services[LiveState].buses[BUS]
        live.apply([Reading(unit, time.time(), 0, 0, 0, REMOTE, 0) for unit in (1, 2)])
        if settled:
            await alarms.act(Person("anna", Role.OPERATOR, "session"), ACKNOWLEDGE, f"{BUS}.1.estop_active.1")
            live.apply([Reading(2, time.time(), 0, 0, 0, REMOTE, HEALTHY)])
        await alarms.write()
        await house.services[AlarmNotifier].load()
        await house.services[AlarmNotifier].advance()


@asynccontextmanager
async def started(
    folder: Path, settings: NotifySettings, stopped: Collection[int] = (1, 2)
) -> AsyncIterator[House]:
    """The server is started on what stands, and has seen to it."""
    async with complete_app(folder, notify=settings) as house:
        await played_line(house.services, stopped)
        notifier = house.services[AlarmNotifier]
        await notifier.load()
        await notifier.advance()
        await notifier.notify_standing()
        yield house


async def test_what_stood_before_notification_was_configured_is_one_message(
    tmp_path: Path, servers: tuple[PlayedMailServer, PlayedReceiver]
) -> None:
    mail, hooks = servers
    await stand(tmp_path)
    settings = notify(mail, hooks, tmp_path)
    async with started(tmp_path, settings) as house:
        digest = (await mail.mail()).get_content()
        assert [name in digest for name in ("Unwind", "Nip")] == [True, True]
        assert digest.count("Emergency stop") >= 2
        alarms = [(await hooks.body(count))["alarm"]["id"] for count in (1, 2)]
        assert alarms == [f"{BUS}.1.estop_active.1", f"{BUS}.2.estop_active.1"]
        await Path_(house, mail, hooks).ended("delivered", 3)
    async with started(tmp_path, settings) as house:
        outbox = house.services[Notification].outbox
        assert await outbox.waiting() == {}, "each address is notified once"
        assert len(await outbox.deliveries(100, None)) == 3
        states = ("delivered", "failed")
        found = {state: len(await outbox.deliveries(9, None, state=state)) for state in states}
        assert found == {"delivered": 3, "failed": 0}


async def test_a_settled_alarm_is_not_notified_at_a_start(
    tmp_path: Path, servers: tuple[PlayedMailServer, PlayedReceiver]
) -> None:
    await stand(tmp_path, settled=True)
    async with started(tmp_path, notify(*servers, tmp_path), (1,)) as house:
        assert await house.services[Notification].outbox.waiting() == {}
        assert await house.services[Notification].outbox.deliveries(100, None) == []


async def test_an_address_that_was_corrected_is_notified_of_what_stands(
    tmp_path: Path, servers: tuple[PlayedMailServer, PlayedReceiver]
) -> None:
    mail, hooks = servers
    smtp = {"host": "127.0.0.1", "port": mail.port, "security": "none", "sender": "lineside@plant"}
    wrong, right = (
        notify(mail, hooks, tmp_path, webhook=[], smtp={**smtp, "to": [to]})
        for to in ("dutty@plant", "duty@plant")
    )
    await stand(tmp_path, notify=wrong)
    async with started(tmp_path, right) as house:
        (delivery,) = await Path_(house, mail, hooks).ended("delivered")
        assert delivery.endpoint == "mail:duty@plant"
        assert [item.alarm for item in delivery.items] == [f"{BUS}.{unit}.estop_active" for unit in (1, 2)]
