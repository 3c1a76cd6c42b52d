"""``GET /stream`` of the complete app, over ASGI as a server calls it."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from app.core.web.access import Role
from app.line.live.api.routes import MAX_STREAMS_OF_ACCOUNT, MAX_STREAMS_OF_ADDRESS, LineStream
from app.line.live.bus_live import LiveState
from app.line.live.requests import Admission
from tests.app.complete_app import HOST, House, complete_app
from tests.app.fake_worker import snapshot
from tests.app.line.test_recent_events import read


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    async with complete_app(tmp_path) as house:
        house.services[LiveState].buses["dry-end"].connect_worker(snapshot())
        yield house


@dataclass
class Response:
    """What has come so far."""

    status: int = 0
    headers: dict[str, str] = field(default_factory=dict)
    body: bytes = b""
    task: asyncio.Task[None] | None = None

    async def until(self, kind: str) -> list[dict[str, Any]]:
        """Wait for an event of this kind; the data of all of them."""
        async with asyncio.timeout(30):
            while True:
                complete = self.body[: self.body.rfind(b"\n\n") + 2]
                found = [data for _, of, data in read(complete) if of == kind]
                if found:
                    return found
                await asyncio.sleep(0.01)


@asynccontextmanager
async def streaming(house: House, token: str, query: str = "") -> AsyncIterator[Response]:
    """A client that reads until it leaves."""
    response, left = Response(), asyncio.Event()

    async def receive() -> dict[str, Any]:
        await left.wait()
        return {"type": "http.disconnect"}

    async def send(message: Any) -> None:
        if message["type"] == "http.response.start":
            response.status = message["status"]
            response.headers = {name.decode(): value.decode() for name, value in message["headers"]}
        else:
            response.body += message.get("body", b"")

    scope = {
        "type": "http",
        "asgi": {"version": "3.0", "spec_version": "2.3"},
        "http_version": "1.1",
        "method": "GET",
        "scheme": "http",
        "path": "/api/v1/stream",
        "raw_path": b"/api/v1/stream",
        "query_string": query.encode(),
        "headers": [(b"host", HOST.encode()), (b"authorization", f"Bearer {token}".encode())],
        "client": ("192.0.2.7", 4711),
        "server": (HOST, 80),
    }
    response.task = asyncio.create_task(house.app(scope, receive, send))
    try:
        yield response
    finally:
        left.set()
        with suppress(TimeoutError):
            await asyncio.wait_for(response.task, 30)


async def test_a_snapshot_then_changes_and_alarms(house: House) -> None:
    async with streaming(house, await house.token(Role.VIEWER)) as response:
        (line,) = await response.until("snapshot")
        assert [unit["name"] for unit in line["buses"][0]["units"]] == ["Unwind", "Nip"]
        assert response.status == 200
        assert response.headers["content-type"].startswith("text/event-stream")
        assert response.headers["cache-control"] == "no-store"
        assert "content-encoding" not in response.headers
        house.services[LiveState].buses["dry-end"].lose_worker(0.0)
        changes = await response.until("change")
        assert changes[0]["bus"] == "dry-end"
        alarm = (await response.until("alarm"))[0]
        assert alarm["code"] == "worker_lost"


async def test_it_ends_with_the_server(house: House) -> None:
    async with streaming(house, await house.token(Role.VIEWER)) as response:
        await response.until("snapshot")
        house.services[LineStream].end()
        assert response.task is not None
        await asyncio.wait_for(response.task, 30)


async def test_an_unknown_bus(house: House) -> None:
    viewer = await house.program(Role.VIEWER)
    response = await viewer.get("/api/v1/stream?bus=nowhere")
    assert response.status_code == 404
    assert response.json()["code"] == "unknown_bus"


async def test_its_headers_alone(house: House) -> None:
    viewer = await house.program(Role.VIEWER)
    response = await asyncio.wait_for(viewer.head("/api/v1/stream"), 30)
    assert response.headers["content-type"].startswith("text/event-stream")
    assert house.services[LineStream].admission.enter("nobody", "nowhere")


async def test_too_many_of_one_account(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    admission = Admission(MAX_STREAMS_OF_ACCOUNT, MAX_STREAMS_OF_ADDRESS)
    monkeypatch.setattr(house.services[LineStream], "admission", admission)
    for number in range(MAX_STREAMS_OF_ACCOUNT):
        assert admission.enter("key-viewer (token)", f"elsewhere {number}")
    viewer = await house.program(Role.VIEWER)
    response = await viewer.get("/api/v1/stream")
    assert response.status_code == 429
    assert response.headers["retry-after"] == "10"
    assert json.loads(response.content)["code"] == "too_many"
    admission.leave("key-viewer (token)", "elsewhere 0")
    assert (await asyncio.wait_for(viewer.head("/api/v1/stream"), 30)).status_code == 200
    assert admission.enter("key-viewer (token)", "elsewhere 0"), "one that has ended counts no more"
