"""Pages that request the complete state repeatedly, and pages by the hundred."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient, WebSocketDenialResponse, WebSocketTestSession
from starlette.websockets import WebSocketDisconnect

from app.core.web.access import Role
from app.line.live import hub
from app.line.live.browser import Browser
from app.line.live.hub import Broadcast, Hub
from app.line.live.requests import MAX_PAGES_OF_ACCOUNT, Admission
from app.main import create_app
from app.people.auth.accounts import Accounts
from tests.administrator import BY
from tests.app.complete_app import settings_in
from tests.app.screens import line, screen

ORIGIN = {"origin": "http://testserver"}


@pytest.fixture
def client(tmp_path: Path) -> Iterator[TestClient]:
    app = create_app(settings_in(tmp_path))
    with TestClient(app) as client:
        make = app.state.services[Accounts].create_token
        token = client.portal.call(lambda: make("t", Role.VIEWER, **BY))  # type: ignore[union-attr]
        client.headers["authorization"] = f"Bearer {token}"
        yield client


def hub_of(client: TestClient) -> Hub:
    hub: Hub = client.app.state.services[Hub]  # type: ignore[attr-defined]
    return hub


async def test_a_page_that_sends_a_thousand_requests_without_reading_waits_for_one_snapshot() -> None:
    broadcast = Broadcast(screen(line()), lambda: 100.0)
    browser = Browser("anna", "viewer", "en")
    broadcast.join(browser)
    for _ in range(1000):
        broadcast.send_snapshot(browser)
    assert [json.loads(text)["is"] for text in await browser.next()] == ["snapshot"]
    assert browser._snapshot is None


def test_endless_requests_of_a_page_get_responses_at_its_pace(
    client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    pauses: list[float] = []
    paces, wait = (1 / hub.SNAPSHOTS_A_SECOND, 1 / hub.MESSAGES_A_SECOND), asyncio.sleep

    async def sleep(seconds: float) -> None:
        # The app's own rhythms go on as they are: without a pause they would leave nothing for anyone else.
        if seconds in paces:
            pauses.append(seconds)
        await wait(0 if seconds in paces else seconds)

    monkeypatch.setattr(hub.asyncio, "sleep", sleep)
    requested = 50
    with client.websocket_connect("/live", headers=ORIGIN) as page:
        for _ in range(requested):
            page.send_text('{"want": "snapshot"}')
        snapshots = 0
        while snapshots < requested - hub.MAX_SNAPSHOTS_AT_ONCE and len(pauses) < requested:
            snapshots += json.loads(page.receive_text())["is"] == "snapshot"
    assert pauses.count(1 / hub.SNAPSHOTS_A_SECOND) >= requested - hub.MAX_SNAPSHOTS_AT_ONCE - 1
    assert pauses.count(1 / hub.MESSAGES_A_SECOND) >= requested - hub.MAX_MESSAGES_AT_ONCE - 1


MALFORMED: list[dict[str, Any]] = [
    {"units": ["dry-end/1"] * 513},
    {"units": ["x" * 49]},
    {"units": [[[["dry-end/1"]]]]},
    {"trace": "x" * 41},
    {"want": "everything"},
    {"want": "snapshot", "more": 1},
]


def read_two_snapshots(page: WebSocketTestSession) -> None:
    """Read the snapshot that every page gets, and the one that was requested."""
    seen: list[str] = []
    while seen.count("snapshot") < 2:
        seen.append(json.loads(page.receive_text())["is"])


def test_a_message_that_no_page_sends_ends_its_socket(client: TestClient) -> None:
    for message in MALFORMED:
        with client.websocket_connect("/live", headers=ORIGIN) as page:
            page.send_json(message)
            page.send_json({"want": "snapshot"})
            with pytest.raises(WebSocketDisconnect):
                read_two_snapshots(page)


def test_the_frames_of_a_bus_are_for_engineers(client: TestClient) -> None:
    """Who sees every frame sees every value, #21 too."""
    with client.websocket_connect("/live", headers=ORIGIN) as page:
        page.send_json({"units": ["dry-end/1"], "trace": "dry-end"})
        page.send_json({"want": "snapshot", "units": ["dry-end/1"], "trace": "dry-end"})
        read_two_snapshots(page)
        (browser,) = hub_of(client)._browsers()
        assert (browser.units, browser.trace) == (frozenset({("dry-end", 1)}), "")


def test_one_page_too_many_is_refused_and_the_others_stay(
    client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    admission = Admission()
    monkeypatch.setattr(hub_of(client), "admission", admission)
    for number in range(MAX_PAGES_OF_ACCOUNT - 1):
        admission.enter("t (token)", f"elsewhere {number}")
    with client.websocket_connect("/live", headers=ORIGIN) as page:
        page.receive_text()
        with (
            pytest.raises(WebSocketDenialResponse) as refused,
            client.websocket_connect("/live", headers=ORIGIN),
        ):
            pass
        assert (refused.value.status_code, refused.value.json()["code"]) == (429, "too_many")
        assert refused.value.headers["retry-after"]
        assert hub_of(client).connected == 1
    with client.websocket_connect("/live", headers=ORIGIN) as page:
        page.receive_text()


def test_a_page_cannot_make_the_server_remember_what_there_is_not(client: TestClient) -> None:
    hub = hub_of(client)
    browser = Browser("anna", "engineer", "en")
    for turn in range(100):
        hub.follow(browser, (f"bus-{turn}/1", f"dry-end/{turn + 3}"), f"bus-{turn}")
    assert (browser.units, browser.trace) == (frozenset(), "")
    assert len(hub._pages._traces) <= 2
