"""Webhooks to a real receiver: signature, refusals in words, and what a receiver cannot do."""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import json
from pathlib import Path
from typing import Any

import pytest

from app.records.notification.senders import post_hook
from app.records.notification.settings import WebhookSettings
from bus.errors import LinesideError
from bus.instants import UnixTime
from tests.app.notification_servers import certificate, receiver, server_context

BODY = {"id": "0123abcd", "kind": "test", "name": "Prüfung"}
AT = UnixTime(1_700_000_000.9)


@pytest.fixture
def key(tmp_path: Path) -> Path:
    file = tmp_path / "hook.key"
    file.write_bytes(b"k\xff y\n")
    return file


async def refusal(url: str, key: Path, **more: Any) -> str:
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
        (b"HTTP/1.1 500 No\r\n\r\n", "refused with status 500"),
        (b"HTTP/1.1 404 No\r\nContent-Length: 99999999999\r\n\r\nx", "refused with status 404"),
        (b"not http\r\n\r\n", "No connection"),
        (b"HTTP/1.1 200 OK\r\nX: " + b"y" * 300_000, "No connection"),
        (b"", "No connection"),
    ],
)
async def test_a_response_without_success_is_reported_in_words(
    key: Path, response: bytes, words: str
) -> None:
    async with receiver(response=response) as played:
        assert words in await refusal(played.url, key)
        assert len(played.received) == 1


async def test_a_body_without_end_is_not_read(key: Path) -> None:
    async with receiver(response=b"HTTP/1.1 200 OK\r\nContent-Length: 9000000\r\n\r\nx") as played:
        async with asyncio.timeout(60):
            await post_hook(WebhookSettings(url=played.url, secret_file=key), BODY, AT)


async def test_a_receiver_that_hangs(key: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("app.records.notification.senders.SOCKET_S", 0.2)
    async with receiver(response=None) as played:
        assert "did not respond in time" in await refusal(played.url, key)


async def test_a_certificate_is_verified(key: Path, tmp_path: Path) -> None:
    file = certificate(tmp_path)
    async with receiver(server_context(file)) as played:
        assert "self-signed certificate" in await refusal(played.url, key)
        await post_hook(WebhookSettings(url=played.url, secret_file=key, ca_file=file), BODY, AT)
        assert await played.body() == BODY


async def test_without_its_secret_nothing_leaves(tmp_path: Path) -> None:
    async with receiver() as played:
        assert "cannot be read" in await refusal(played.url, tmp_path / "gone")
        (tmp_path / "empty").write_text("\n")
        assert "holds no secret" in await refusal(played.url, tmp_path / "empty")
        assert played.received == []


async def test_a_proxy_of_the_environment_is_not_used(key: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HTTP_PROXY", "http://127.0.0.1:1")
    monkeypatch.delenv("NO_PROXY", raising=False)
    async with receiver() as played:
        await post_hook(WebhookSettings(url=played.url, secret_file=key), BODY, AT)
        assert await played.body() == BODY
