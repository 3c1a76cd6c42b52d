"""Mail to a real server: encryption, refusals in words, and what a name cannot do."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import AsyncIterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from app.records.notification.compose import Letter
from app.records.notification.rules import NotDeliveredError
from app.records.notification.senders import MAIL_PASSWORD_VARIABLE, reach_mail_server, send_mail
from app.records.notification.settings import SmtpSettings
from tests.app.notification_servers import PlayedMailServer, certificate, mail_server, server_context

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


def settings(port: int, authority: Path | None = None, **more: Any) -> SmtpSettings:
    known = {"host": "127.0.0.1", "port": port, "sender": "lineside@plant", "ca_file": authority}
    return SmtpSettings.model_validate({**known, **more})


async def refusal(settings: SmtpSettings, letter: Letter = LETTER) -> str:
    with pytest.raises(NotDeliveredError) as raised:
        await send_mail(settings, "duty@plant", letter)
    return str(raised.value)


async def test_a_mail_arrives_encrypted_with_its_id(server: PlayedMailServer, authority: Path) -> None:
    await send_mail(settings(server.port, authority), "duty@plant", LETTER)
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
    await reach_mail_server(settings(server.port, authority, user="u", password_file=file))
    words = [command.split()[0].upper() for command in server.commands]
    assert words.index("STARTTLS") < words.index("AUTH")
    assert server.mails == []


async def test_a_password_of_the_environment(
    server: PlayedMailServer, authority: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(MAIL_PASSWORD_VARIABLE, raising=False)
    assert MAIL_PASSWORD_VARIABLE in await refusal(settings(server.port, authority, user="u"))
    monkeypatch.setenv(MAIL_PASSWORD_VARIABLE, "s3cret")
    await reach_mail_server(settings(server.port, authority, user="u"))


async def test_a_server_without_encryption_gets_nothing(authority: Path) -> None:
    async with mail_server() as plain:
        assert "offers no encryption" in await refusal(settings(plain.port, authority))
        assert all(command.split()[0].lower() in ("ehlo", "quit") for command in plain.commands)


async def test_a_certificate_that_no_one_vouches_for_is_refused(server: PlayedMailServer) -> None:
    assert "is not trusted" in await refusal(settings(server.port))
    assert server.mails == []


@pytest.mark.parametrize(
    ("replies", "words"),
    [
        ({"MAIL": "550 no\x1b[31m such sender"}, "refused: 550 no [31m such sender"),
        ({"RCPT": "451 later"}, "refused: 451 later"),
        ({"DATA": "554 no"}, "refused: 554 no"),
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
        reason = await refusal(settings(server.port, authority, user="u", password_file=file))
    assert words in reason
    assert "s3cret" not in reason


async def test_a_server_that_is_not_there(authority: Path) -> None:
    async with mail_server() as server:
        port = server.port
    assert f"No connection to 127.0.0.1:{port}: Connection refused" in await refusal(
        settings(port, authority)
    )
    assert "There is no host plant.invalid" in await refusal(settings(port, authority, host="plant.invalid"))


async def test_one_that_does_not_respond(authority: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("app.records.notification.senders.SOCKET_S", 0.2)
    async with mail_server(greeting="") as server:
        assert "did not respond in time" in await refusal(settings(server.port, authority))


async def test_who_waits_may_stop(context: ssl.SSLContext, authority: Path) -> None:
    async with mail_server(context, replies={"RCPT": ""}) as server:
        sending = asyncio.create_task(send_mail(settings(server.port, authority), "duty@plant", LETTER))
        async with asyncio.timeout(60), server.arrived:
            await server.arrived.wait_for(lambda: any("rcpt" in each for each in server.commands))
        sending.cancel()
        with pytest.raises(asyncio.CancelledError):
            await sending
    assert server.mails == []


async def test_a_subject_with_a_line_break_is_no_header(server: PlayedMailServer, authority: Path) -> None:
    letter = Letter("1", "a\r\nBcc: evil@example.org", "", LETTER.at)
    with pytest.raises(ValueError, match="linefeed"):
        await send_mail(settings(server.port, authority), "duty@plant", letter)
    assert server.mails == []
