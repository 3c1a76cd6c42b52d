"""GET /stream of the complete app, and the AsyncAPI document that describes it."""

from __future__ import annotations

import asyncio
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import pytest
from jsonschema_rs import Draft202012Validator

from app.core.web.access import Role
from app.core.web.api import openapi_document
from app.line.alarms.api import AlarmShown, alarm_json
from app.line.alarms.line_alarms import LineAlarms
from app.line.live.api.routes import (
    MAX_STREAMS_OF_ACCOUNT,
    MAX_STREAMS_OF_ADDRESS,
    AlarmType,
    LineStream,
    stream_document,
)
from app.line.live.bus_live import LiveState
from app.line.live.requests import Admission
from tests.app.complete_app import HOST, Api, House, complete_app, served
from tests.app.fake_worker import snapshot
from tests.app.line.test_line_stream import read
from tests.app.strict_schema import strict


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


ALARM = AlarmType(AlarmShown)
KINDS = ("snapshot", "change", "alarm", "heartbeat")
CHAPTER = Path(__file__).resolve().parents[3] / "docs" / "api.md"
PROGRAMS = {"python": [sys.executable, "-c"], "js": ["node", "--input-type=module", "-e"], "sh": ["sh", "-c"]}


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    with served(tmp_path_factory.mktemp("stream")) as api:
        yield api


def resolved(document: dict[str, Any], node: dict[str, Any]) -> dict[str, Any]:
    """What a reference leads to."""
    while "$ref" in node:
        found: Any = document
        for step in node["$ref"].removeprefix("#/").split("/"):
            found = found[step]
        node = found
    return node


def references(node: Any) -> Iterator[dict[str, Any]]:
    """Every reference below a node."""
    if isinstance(node, list):
        for each in node:
            yield from references(each)
    elif isinstance(node, dict):
        if isinstance(node.get("$ref"), str):
            yield node
        for each in node.values():
            yield from references(each)


def test_it_has_the_structure_of_asyncapi_3() -> None:
    document = stream_document(ALARM)
    assert document["asyncapi"] == "3.0.0"
    assert document["info"].keys() >= {"title", "version"}
    assert document.keys() <= {
        *("asyncapi", "id", "info", "defaultContentType", "servers", "channels", "operations", "components")
    }
    for reference in references(document):
        assert resolved(document, reference)
    for server in document["servers"].values():
        assert server.keys() >= {"host", "protocol"}
        assert re.findall(r"{(\w+)}", server["host"]) == list(server["variables"])
    for channel in document["channels"].values():
        assert channel["address"].startswith("/")
    for operation in document["operations"].values():
        assert operation["action"] in ("send", "receive")
        channel = resolved(document, operation["channel"])
        for message in operation["messages"]:
            # A message of an operation is one of its channel (AsyncAPI 3.0, Operation Object).
            assert message["$ref"].startswith(operation["channel"]["$ref"] + "/messages/")
            assert message["$ref"].rpartition("/")[2] in channel["messages"]
    assert list(document["components"]["messages"]) == list(KINDS)


def validator(kind: str) -> Draft202012Validator:
    """Judge the data of an event."""
    document = stream_document(ALARM)
    payload = document["components"]["messages"][kind]["payload"]
    return Draft202012Validator({**payload, "components": strict(document["components"])})


async def test_real_events_are_as_described(house: House) -> None:
    async with streaming(house, await house.token(Role.VIEWER)) as response:
        await response.until("snapshot")
        house.services[LiveState].buses["dry-end"].lose_worker(0.0)
        alarms, stream = house.services[LineAlarms], house.services[LineStream]
        # A lost worker is an alarm after ten seconds only.
        stream.add("alarm", "dry-end", partial(alarm_json, alarms, next(alarms.every())))
        stream.tick(with_heartbeat=True)
        for kind in KINDS:
            judge = validator(kind)
            for data in await response.until(kind):
                judge.validate(data)


def test_examples_are_as_described_and_a_wrong_event_is_none() -> None:
    for name, message in stream_document(ALARM)["components"]["messages"].items():
        for example in message.get("examples", ()):
            validator(name).validate(example["payload"])
    assert not validator("heartbeat").is_valid({"time": None})
    assert not validator("change").is_valid({"bus": "dry-end", "unit": 1, "actual_raw": "fast"})
    assert not validator("change").is_valid({"bus": "dry-end", "unit": 1, "nothing": 1})


async def test_it_has_the_schemas_of_the_openapi_document(house: House) -> None:
    ours = stream_document(ALARM)["components"]["schemas"]
    theirs = openapi_document(house.app)["components"]["schemas"]
    assert len(ours.keys() & theirs.keys()) >= 8
    assert {name: ours[name] for name in ours.keys() & theirs.keys()} == {
        name: theirs[name] for name in ours.keys() & theirs.keys()
    }


def test_it_is_served_to_viewers(api: Api) -> None:
    url = f"{api.url}/api/v1/asyncapi.json"
    assert httpx.get(url, trust_env=False, timeout=60).status_code == 401
    assert httpx.get(url, headers=api.headers, trust_env=False, timeout=60).json() == stream_document(ALARM)


@pytest.mark.parametrize("language", PROGRAMS)
def test_the_documented_program_follows_the_stream(api: Api, language: str) -> None:
    part = CHAPTER.read_text(encoding="utf-8").partition("**Programs that follow the stream.**")[2]
    found = re.search(rf"```{language}\n(.*?)```", part, re.S)
    assert found is not None
    assert len(found[1].splitlines()) <= 12
    program = found[1].replace("http://127.0.0.1:8000", api.url)
    words = [*PROGRAMS[language], program]
    environment = {**os.environ, "TOKEN": api.token}
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, text=True, env=environment, start_new_session=True
    ) as process:
        assert process.stdout is not None
        try:
            assert any("Mill 7" in line and "Unwind" in line for line in process.stdout)
        finally:
            os.killpg(process.pid, signal.SIGTERM)
