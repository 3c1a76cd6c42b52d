"""What people and programs are sent, and services that apprise reaches."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from app.core.messages.languages import Languages
from app.core.web.formats import Formats
from app.records.notification.compose import Composer, Letter, hook_body
from app.records.notification.outbox import AlarmNotice, NoticeKind, NotificationDelivery, OutboxItem
from app.records.notification.plan import NotificationEndpoint
from app.records.notification.rules import NotDeliveredError
from app.records.notification.senders import Senders, notify_by_apprise
from app.records.notification.settings import AppriseSettings
from bus.instants import UnixTime
from bus.messages import Message
from tests.app.notification_servers import receiver

NOW = UnixTime(1_800_000_000.0)
EVIL = "Dryer\r\nBcc: evil@example.org\r\n\r\nAcknowledge: https://evil.example"


def composer(language: str = "en", link: Callable[[str], str] = lambda id: f"https://plant/{id}") -> Composer:
    found = Languages()[language]
    return Composer("Mill 7", found, Formats(found.locale), link)


def item(kind: NoticeKind = "alarm", name: str = "Too slow", **more: Any) -> OutboxItem:
    known: dict[str, Any] = {
        "id": "b.1.x.1",
        "code": "x",
        "name": Message.of("alarm_own_text", text=name),
        "place": name,
        "bus": "b",
        "unit": 1,
        "priority": "high",
        "state": "unack_active",
        "active": True,
        "at": float(NOW),
        "cause": Message.of("alarm_own_text", text=name),
        "response": Message.of("alarm_own_text", text=name),
    }
    return OutboxItem("k", "mail:a@b", kind, NOW, AlarmNotice(**known | more))


def delivery(*items: OutboxItem) -> NotificationDelivery:
    return NotificationDelivery(1, "mail:a@b", "0123", "sending", 0, NOW, NOW, NOW, None, items)


def test_a_name_with_line_breaks_makes_no_header_and_no_line() -> None:
    letter = composer().letter(delivery(item(name=EVIL)), NOW)
    assert letter.subject == letter.subject.splitlines()[0]
    assert not any(line.startswith(("Bcc", "Acknowledge: ")) for line in letter.body.splitlines())


def test_a_digest_begins_with_the_most_urgent() -> None:
    items = (
        item("clear", "gone", priority="urgent"),
        item(name="low", priority="low"),
        item(name="top", priority="urgent"),
    )
    letter = composer().letter(delivery(*items), NOW)
    assert letter.subject == "Mill 7: 3 messages, 1 of them urgent"
    heads = [paragraph.splitlines()[0] for paragraph in letter.body.split("\n\n")]
    assert heads[:3] == ["urgent: top · top", "low: low · low", "Cleared: gone · gone"]
    assert letter.is_urgent


def test_only_an_alarm_that_waits_has_a_link() -> None:
    waits = composer().letter(delivery(item("clear", state="rtn_unack", active=False)), NOW)
    over = composer().letter(delivery(item("clear", state="normal", active=False)), NOW)
    without = composer(link=lambda _: "").letter(delivery(item()), NOW)
    assert ["https://" in letter.body for letter in (waits, over, without)] == [True, False, False]


def test_the_texts_of_a_german_site() -> None:
    letter = composer("de").letter(delivery(item(escalated=True)), NOW)
    assert letter.subject == "Nicht quittiert, hoch: Too slow · Too slow"
    test = OutboxItem("k", "mail:a@b", "test", NOW)
    assert "Nichts ist zu tun" in composer("de").letter(delivery(test), NOW).body


def test_the_body_of_a_webhook_has_texts_as_data() -> None:
    body = hook_body("Mill 7", delivery(item()), NOW)
    assert body["alarm"]["message"] == body["alarm"]["alarm_message"]["detail"] == "Too slow. Too slow"
    assert "alarm" not in hook_body("Mill 7", delivery(OutboxItem("k", "e", "heartbeat", NOW)), NOW)


@pytest.fixture
def settings(tmp_path: Path) -> AppriseSettings:
    file = tmp_path / "url"
    file.write_text("json://plant/s3cret\n")
    return AppriseSettings(url_file=file)


async def test_apprise_is_an_extra(settings: AppriseSettings, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "apprise", None)
    with pytest.raises(NotDeliveredError, match="is not installed"):
        await notify_by_apprise(settings, composer().letter(delivery(item()), NOW))


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the plug-ins of apprise
async def test_apprise_delivers(settings: AppriseSettings) -> None:
    letter: Letter = composer().letter(delivery(item()), NOW)
    async with receiver() as hooks:
        settings.url_file.write_text(hooks.url.replace("http://", "json://"))
        await notify_by_apprise(settings, letter)
        sent = await hooks.body()
    assert (sent["title"], sent["message"]) == (letter.subject, letter.body.rstrip())
    async with receiver(response=b"HTTP/1.1 500 Broken\r\nContent-Length: 0\r\n\r\n") as hooks:
        settings.url_file.write_text(hooks.url.replace("http://", "json://"))
        with pytest.raises(NotDeliveredError, match="did not take the message"):
            await notify_by_apprise(settings, letter)
    settings.url_file.write_text("plant")
    with pytest.raises(NotDeliveredError, match="holds no URL that apprise knows"):
        await notify_by_apprise(settings, letter)


async def test_a_way_that_hangs_or_fails_unexpectedly_ends_in_words(
    settings: AppriseSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def hangs(*_: object) -> None:
        await asyncio.Event().wait()

    async def fails(*_: object) -> None:
        raise RuntimeError("s3cret")

    endpoint = NotificationEndpoint("apprise", "plant", settings)
    way = "app.records.notification.senders.notify_by_apprise"
    senders = Senders(None, composer())
    monkeypatch.setattr(way, hangs)
    with monkeypatch.context() as bounded:
        bounded.setattr("app.records.notification.senders.ATTEMPT_S", 0.0)
        with pytest.raises(NotDeliveredError, match="No result after 0 s"):
            await senders.send(endpoint, delivery(item()), NOW)
    monkeypatch.setattr(way, fails)
    with pytest.raises(NotDeliveredError) as raised:
        await senders.send(endpoint, delivery(item()), NOW)
    assert "RuntimeError" in str(raised.value)
    assert "s3cret" not in str(raised.value)
    with pytest.raises(NotDeliveredError, match=r"add \[notify\.smtp\]"):
        await senders.send(NotificationEndpoint("mail", "a@b"), delivery(item()), NOW)
