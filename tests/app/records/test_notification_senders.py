"""What people and programs are sent, and how: mail to a real server, webhooks to a real receiver, and
apprise."""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import json
import ssl
import sys
from collections.abc import AsyncIterator, Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from app.core.messages.languages import Languages
from app.core.web.formats import Formats
from app.records.notification.compose import Composer, Letter, hook_body
from app.records.notification.outbox import AlarmNotice, NoticeKind, NotificationDelivery, OutboxItem
from app.records.notification.rules import NotDeliveredError, NotificationEndpoint
from app.records.notification.senders import (
    MAIL_PASSWORD_VARIABLE,
    Senders,
    notify_by_apprise,
    post_hook,
    reach_mail_server,
    send_mail,
)
from app.records.notification.settings import AppriseSettings, SmtpSettings, WebhookSettings
from bus.errors import LinesideError
from bus.instants import UnixTime
from bus.messages import Message
from tests.app.notification_servers import (
    PlayedMailServer,
    certificate,
    mail_server,
    receiver,
    server_context,
)

LETTER = Letter(
    "0123abcd", "urgent: Unwind · Nothalt", "Ä\n" + "x" * 2000, datetime(2026, 11, 22, tzinfo=UTC)
)


@pytest.fixture(scope="module")
def authority(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return certificate(tmp_path_factory.mktemp("certificate"))


@pytest.fixture(scope="module")
def context(authority: Path) -> ssl.SSLContext:
    return server_context(authority)


@pytest.fixture
async def server(context: ssl.SSLContext) -> AsyncIterator[PlayedMailServer]:
    async with mail_server(context) as played:
        yield played


def smtp(port: int, authority: Path | None = None, **more: Any) -> SmtpSettings:
    known = {"host": "127.0.0.1", "port": port, "sender": "lineside@plant", "ca_file": authority}
    return SmtpSettings.model_validate({**known, **more})


async def mail_refusal(settings: SmtpSettings, letter: Letter = LETTER) -> str:
    with pytest.raises(NotDeliveredError) as raised:
        await send_mail(settings, "duty@plant", letter)
    return str(raised.value)


async def test_a_mail_arrives_encrypted_with_its_id(server: PlayedMailServer, authority: Path) -> None:
    await send_mail(smtp(server.port, authority), "duty@plant", LETTER)
    mail = await server.mail()
    assert server.is_encrypted
    assert server.recipients == ["duty@plant"]
    assert (mail["Subject"], mail["Message-ID"]) == (LETTER.subject, "<0123abcd@plant>")
    assert mail["Auto-Submitted"] == "auto-generated"
    assert mail.get_content().splitlines() == LETTER.body.splitlines()


async def test_a_password_goes_over_the_encrypted_connection_only(
    server: PlayedMailServer, authority: Path, tmp_path: Path
) -> None:
    file = tmp_path / "password"
    file.write_text("s3cret\n")
    await reach_mail_server(smtp(server.port, authority, user="u", password_file=file))
    words = [command.split()[0].upper() for command in server.commands]
    assert words.index("STARTTLS") < words.index("AUTH")
    assert server.mails == []


async def test_the_password_may_be_in_the_environment(
    server: PlayedMailServer, authority: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(MAIL_PASSWORD_VARIABLE, raising=False)
    assert MAIL_PASSWORD_VARIABLE in await mail_refusal(smtp(server.port, authority, user="u"))
    monkeypatch.setenv(MAIL_PASSWORD_VARIABLE, "s3cret")
    await reach_mail_server(smtp(server.port, authority, user="u"))


async def test_a_server_without_encryption_gets_nothing(authority: Path) -> None:
    async with mail_server() as plain:
        assert "offers no encryption" in await mail_refusal(smtp(plain.port, authority))
        assert all(command.split()[0].lower() in ("ehlo", "quit") for command in plain.commands)


async def test_a_certificate_that_no_one_vouches_for_is_refused(server: PlayedMailServer) -> None:
    assert "is not trusted" in await mail_refusal(smtp(server.port))
    assert server.mails == []


@pytest.mark.parametrize(
    ("replies", "words"),
    [
        ({"MAIL": "550 no\x1b[31m such sender"}, "refused: 550 no [31m such sender"),
        ({"RCPT": "451 later"}, "refused: 451 later"),
        ({"CONTENT": "552 full"}, "refused: 552 full"),
        ({"AUTH": "535 wrong"}, "refused user or password: 535 wrong"),
    ],
)
async def test_a_refusal_is_reported_in_words(
    context: ssl.SSLContext, authority: Path, tmp_path: Path, replies: dict[str, str], words: str
) -> None:
    file = tmp_path / "password"
    file.write_text("s3cret")
    async with mail_server(context, replies=replies) as server:
        reason = await mail_refusal(smtp(server.port, authority, user="u", password_file=file))
    assert words in reason
    assert "s3cret" not in reason


async def test_a_mail_server_that_is_not_there_is_reported(authority: Path) -> None:
    async with mail_server() as server:
        port = server.port
    assert f"No connection to 127.0.0.1:{port}: Connection refused" in await mail_refusal(
        smtp(port, authority)
    )
    assert "There is no host plant.invalid" in await mail_refusal(smtp(port, authority, host="plant.invalid"))


async def test_a_mail_server_that_does_not_respond_is_reported(
    authority: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.records.notification.senders.SOCKET_S", 0.2)
    async with mail_server(greeting="") as server:
        assert "did not respond in time" in await mail_refusal(smtp(server.port, authority))


async def test_a_canceled_mail_is_not_delivered(context: ssl.SSLContext, authority: Path) -> None:
    async with mail_server(context, replies={"RCPT": ""}) as server:
        sending = asyncio.create_task(send_mail(smtp(server.port, authority), "duty@plant", LETTER))
        async with asyncio.timeout(60), server.arrived:
            await server.arrived.wait_for(lambda: any("rcpt" in each for each in server.commands))
        sending.cancel()
        with pytest.raises(asyncio.CancelledError):
            await sending
    assert server.mails == []


async def test_a_subject_with_a_line_break_is_no_header(server: PlayedMailServer, authority: Path) -> None:
    letter = Letter("1", "a\r\nBcc: evil@example.org", "", LETTER.at)
    with pytest.raises(ValueError, match="linefeed"):
        await send_mail(smtp(server.port, authority), "duty@plant", letter)
    assert server.mails == []


BODY = {"id": "0123abcd", "kind": "test", "name": "Prüfung"}
AT = UnixTime(1_700_000_000.9)


@pytest.fixture
def key(tmp_path: Path) -> Path:
    file = tmp_path / "hook.key"
    file.write_bytes(b"k\xff y\n")
    return file


async def hook_refusal(url: str, key: Path, **more: Any) -> str:
    with pytest.raises(LinesideError) as raised:
        await post_hook(WebhookSettings(url=url, secret_file=key, **more), BODY, AT)
    assert "s3cret" not in str(raised.value)
    return str(raised.value)


async def test_a_webhook_is_signed_and_has_its_id(key: Path) -> None:
    async with receiver() as played:
        await post_hook(WebhookSettings(url=played.url, secret_file=key), BODY, AT)
        assert await played.body() == BODY
    ((headers, body),) = played.received
    signed = hmac.new(b"k\xff y", b"1700000000." + body, hashlib.sha256).hexdigest()
    assert headers["lineside-signature"] == f"t=1700000000,v1={signed}"
    assert headers["lineside-delivery"] == "0123abcd"
    assert json.loads(body) == BODY


async def test_a_url_that_is_a_secret_is_in_a_file(key: Path, tmp_path: Path) -> None:
    file = tmp_path / "url"
    async with receiver() as played:
        file.write_text(played.url + "\n")
        await post_hook(WebhookSettings(url_file=file, secret_file=key), BODY, AT)
        assert await played.body() == BODY
    file.write_text("ftp://plant")
    with pytest.raises(LinesideError, match="holds no URL"):
        await post_hook(WebhookSettings(url_file=file, secret_file=key), BODY, AT)


@pytest.mark.parametrize(
    ("response", "words"),
    [
        (
            b"HTTP/1.1 302 Found\r\nLocation: http://127.0.0.1:1/\r\n\r\n",
            "redirects to another address (302)",
        ),
        (b"HTTP/1.1 404 No\r\nContent-Length: 99999999999\r\n\r\nx", "refused with status 404"),
        (b"not http\r\n\r\n", "No connection"),
        (b"HTTP/1.1 200 OK\r\nX: " + b"y" * 300_000, "No connection"),
    ],
)
async def test_a_response_without_success_is_reported_in_words(
    key: Path, response: bytes, words: str
) -> None:
    async with receiver(response=response) as played:
        assert words in await hook_refusal(played.url, key)
        assert len(played.received) == 1


async def test_a_body_without_end_is_not_read(key: Path) -> None:
    async with receiver(response=b"HTTP/1.1 200 OK\r\nContent-Length: 9000000\r\n\r\nx") as played:
        async with asyncio.timeout(60):
            await post_hook(WebhookSettings(url=played.url, secret_file=key), BODY, AT)


async def test_a_receiver_that_hangs_is_reported(key: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("app.records.notification.senders.SOCKET_S", 0.2)
    async with receiver(response=None) as played:
        assert "did not respond in time" in await hook_refusal(played.url, key)


async def test_the_certificate_of_a_receiver_is_verified(key: Path, tmp_path: Path) -> None:
    file = certificate(tmp_path)
    async with receiver(server_context(file)) as played:
        assert "self-signed certificate" in await hook_refusal(played.url, key)
        await post_hook(WebhookSettings(url=played.url, secret_file=key, ca_file=file), BODY, AT)
        assert await played.body() == BODY


async def test_without_its_secret_a_webhook_sends_nothing(tmp_path: Path) -> None:
    async with receiver() as played:
        assert "cannot be read" in await hook_refusal(played.url, tmp_path / "gone")
        (tmp_path / "empty").write_text("\n")
        assert "holds no secret" in await hook_refusal(played.url, tmp_path / "empty")
        assert played.received == []


async def test_a_proxy_of_the_environment_is_not_used(key: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HTTP_PROXY", "http://127.0.0.1:1")
    monkeypatch.delenv("NO_PROXY", raising=False)
    async with receiver() as played:
        await post_hook(WebhookSettings(url=played.url, secret_file=key), BODY, AT)
        assert await played.body() == BODY


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


async def test_an_attempt_that_hangs_or_fails_unexpectedly_ends_in_words(
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
