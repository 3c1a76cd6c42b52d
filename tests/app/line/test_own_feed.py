"""The port of the server's own workers serves their feed and nothing else; a server in clear is named so."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from starlette.types import Message, Receive, Scope, Send

from app.cli.server import OnlyFeed
from app.core.server.settings import TlsSettings
from app.core.server.tls import Encryption
from app.main import create_app
from app.settings import ServerSettings
from tests.app.complete_app import settings_in
from tests.certificates import certificates

FEED = ("127.0.0.1", 40_000)


async def sent(scope: dict[str, Any]) -> list[Message]:
    """What a client gets of an app that sends "fed"."""
    messages: list[Message] = []

    async def app(_scope: Scope, _receive: Receive, send: Send) -> None:
        await send({"type": "fed"})

    async def receive() -> Message:
        return {"type": "http.request"}

    async def send(message: Message) -> None:
        messages.append(message)

    await OnlyFeed(app, FEED)({"server": FEED, **scope}, receive, send)
    return messages


async def test_only_the_feed_is_served() -> None:
    assert await sent({"type": "websocket", "path": "/feed"}) == [{"type": "fed"}]
    assert await sent({"type": "websocket", "path": "/live"}) == [{"type": "websocket.close", "code": 1008}]
    start, body = await sent({"type": "http", "path": "/feed", "method": "GET", "headers": []})
    assert start["status"] == 400
    assert b"tls_required" in body["body"]


@pytest.mark.parametrize("server", [("192.0.2.1", 443), ("192.0.2.1", 40_000), None])
async def test_everything_is_served_elsewhere(server: tuple[str, int] | None) -> None:
    assert await sent({"type": "http", "path": "/", "server": server}) == [{"type": "fed"}]


@pytest.mark.parametrize(
    ("host", "is_in_clear"),
    [("127.0.0.1", False), ("localhost", False), ("0.0.0.0", True), ("plant", True)],
)
def test_other_machines_reach_it_in_clear(tmp_path: Path, host: str, is_in_clear: bool) -> None:
    server = ServerSettings(host=host, data=tmp_path / "data")
    app = create_app(settings_in(tmp_path).model_copy(update={"server": server}))
    fault = app.state.services[Encryption].fault
    assert (fault is not None and fault.code == "tls_missing") == is_in_clear


def test_with_a_certificate_its_fault_is_that_of_the_server(tmp_path: Path) -> None:
    folder = certificates(tmp_path)
    tls = TlsSettings(certificate=Path("expired.pem"), key=Path("expired.key")).in_folder(folder)
    server = ServerSettings(host="0.0.0.0", data=tmp_path / "data", tls=tls)
    app = create_app(settings_in(tmp_path).model_copy(update={"server": server}))
    fault = app.state.services[Encryption].fault
    assert fault is not None
    assert fault.code == "tls_expired"
