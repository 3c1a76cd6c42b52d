"""Programs that are notified: webhooks, by one signed POST for each notice, and what the package apprise
reaches (the extra ``lineside[apprise]``)."""

from __future__ import annotations

import hmac
import json
import ssl
from collections.abc import Mapping
from importlib import import_module
from typing import Any
from urllib.parse import urlsplit

from app.core.server.in_thread import in_thread
from app.core.server.settings import check_web_url, read_secret, read_secret_text
from app.errors import network_cause
from app.records.notification.compose import Letter
from app.records.notification.rules.delivery import NotDeliveredError
from app.records.notification.settings import AppriseSettings, WebhookSettings
from bus.instants import UnixTime
from bus.messages import Message

SOCKET_S = 10.0
SIGNATURE_HEADER = "Lineside-Signature"
DELIVERY_HEADER = "Lineside-Delivery"


def signature(secret: bytes, body: bytes, at: int) -> str:
    """``t=<unix seconds>,v1=<hex>``: HMAC-SHA256 of the time, a full stop and the body."""
    return f"t={at},v1={hmac.new(secret, b'%d.' % at + body, 'sha256').hexdigest()}"


async def post(settings: WebhookSettings, body: Mapping[str, Any], now: UnixTime) -> None:
    """Deliver one notice; ``body["id"]`` lets the receiver drop a duplicate. Raises LinesideError."""
    content = json.dumps(body, ensure_ascii=False, separators=(",", ":")).encode()
    headers = {
        "Content-Type": "application/json",
        SIGNATURE_HEADER: signature(read_secret(settings.secret_file), content, int(float(now))),
        DELIVERY_HEADER: str(body["id"]),
    }
    status = await _exchange(settings, "POST", headers, content)
    if not 200 <= status < 300:
        raise NotDeliveredError(_refusal(settings, status))


async def reach(settings: WebhookSettings) -> None:
    """Have its server respond; nothing is notified. Raises LinesideError."""
    read_secret(settings.secret_file)
    status = await _exchange(settings, "HEAD", {}, b"")
    if 300 <= status < 400:
        raise NotDeliveredError(_refusal(settings, status))


async def _exchange(
    settings: WebhookSettings, method: str, headers: Mapping[str, str], content: bytes
) -> int:
    """The status of the response. Its body is not read, so it cannot be too large."""
    import httpx  # a tenth of a second of the start

    url = _url_of(settings)
    place = _place(url)
    try:
        # No proxy and no password of the environment: they lead out of the plant.
        context = ssl.create_default_context(cafile=settings.ca_file)
        client = httpx.AsyncClient(verify=context, trust_env=False, timeout=SOCKET_S)
        async with (
            client,
            client.stream(
                method,
                url,
                headers={"User-Agent": "lineside", **headers},
                content=content,
                follow_redirects=False,
            ) as response,
        ):
            return response.status_code
    except httpx.TimeoutException:
        raise NotDeliveredError(Message.of("notify_timed_out", **place)) from None
    except (httpx.HTTPError, httpx.InvalidURL, OSError, ValueError) as error:
        raise NotDeliveredError(
            Message.of("notify_not_connected", **place, reason=network_cause(error))
        ) from None


def _url_of(settings: WebhookSettings) -> str:
    if settings.url is not None:
        return settings.url
    assert settings.url_file is not None
    try:
        return check_web_url(read_secret_text(settings.url_file))
    except ValueError:
        raise NotDeliveredError(Message.of("notify_secret_not_url", path=str(settings.url_file))) from None


def _place(url: str) -> dict[str, Any]:
    """Host and port: the rest of a URL may be a secret."""
    parts = urlsplit(url)
    return {"host": parts.hostname or "", "port": parts.port or (443 if parts.scheme == "https" else 80)}


def _refusal(settings: WebhookSettings, status: int) -> Message:
    code = "notify_redirected" if 300 <= status < 400 else "notify_http_refused"
    return Message.of(code, **_place(_url_of(settings)), status=status)


async def notify_by_apprise(settings: AppriseSettings, letter: Letter) -> None:
    """Deliver a message. Raises LinesideError; apprise does not give the reason."""

    def send() -> bool:
        return bool(apprise_service(settings).notify(title=letter.subject, body=letter.body))

    # The thread also imports the package, which takes as long as a tenth of a second.
    if not await in_thread(send):
        raise NotDeliveredError(Message.of("notify_apprise_refused", name=settings.url_file.name))


def apprise_service(settings: AppriseSettings) -> Any:
    """Open the service of the URL. Raises LinesideError."""
    try:
        package = import_module("apprise")
    except ImportError:
        raise NotDeliveredError(Message("notify_apprise_missing")) from None
    service = package.Apprise()
    if not service.add(read_secret_text(settings.url_file)):
        raise NotDeliveredError(Message.of("notify_apprise_url", path=str(settings.url_file)))
    return service
