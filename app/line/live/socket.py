"""The WebSocket ``/live`` of an open page: it receives changes, and may request a snapshot.

Commands never come this way: one that was clicked while a socket was down must never be sent later.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Annotated, Literal

import msgspec
from fastapi import APIRouter, WebSocket
from starlette.requests import Request
from starlette.websockets import WebSocketDisconnect

from app.core.server.addresses import source_of
from app.core.web.access import Person, Role, Viewer
from app.core.web.problems import refuse_socket
from app.core.web.routes import GuardedRoute
from app.core.web.services import service_of
from app.core.web.templating import WEBSOCKET_LINES, templates_of
from app.errors import Problem
from app.line.live.browser import Browser
from app.line.live.hub import Hub
from bus.instants import monotonic_now
from bus.messages import Message
from bus.pacing import Bucket

router = APIRouter(route_class=GuardedRoute)

IDLE_TIMEOUT_S = 30.0
"""A page that sends nothing for this long is gone; it sends every ten seconds."""


MESSAGES_A_SECOND, MAX_MESSAGES_AT_ONCE = 2.0, 10
SNAPSHOTS_A_SECOND, MAX_SNAPSHOTS_AT_ONCE = 0.5, 3
"""Limits of a page. The complete state of a large line is a quarter of a megabyte."""


class PageMessage(msgspec.Struct, forbid_unknown_fields=True):
    """The message of a page. ``units``: the units it shows, as ``bus/unit``; ``trace``: a bus to follow, for
    an engineer, as the frames show every value that passed; ``lines``: whether it shows all lines."""

    want: Literal["", "snapshot"] = ""
    units: Annotated[list[Annotated[str, msgspec.Meta(max_length=48)]], msgspec.Meta(max_length=512)] = []
    trace: Annotated[str, msgspec.Meta(max_length=40)] = ""
    lines: bool = False


_decoder = msgspec.json.Decoder(PageMessage)


@router.websocket("/live")
async def live(websocket: WebSocket, person: Viewer, language: str = "") -> None:
    """Serve one page from its opening to its end. ``language``: that of the page, so that both are the
    same."""
    hub, address = service_of(websocket, Hub), source_of(websocket.client.host if websocket.client else "")
    if not hub.admission.enter(person.account, address):
        problem = Problem(429, "too_many", Message("too_many_pages"))
        await refuse_socket(websocket, problem.with_headers(Retry_After="10"))
        return
    try:
        await _serve(websocket, person, language, hub)
    finally:
        hub.admission.leave(person.account, address)


@router.get("/live", include_in_schema=False)
async def no_socket(request: Request, person: Viewer, failed: bool = False) -> None:
    """Respond to a request that is no WebSocket handshake: a proxy has left out the upgrade, or a page
    without a socket asks whether the server responds at all. ``failed``: it does, and no socket opens.

    Raises Problem 426, and 429 if sockets are refused for another reason.
    """
    hub, address = service_of(request, Hub), source_of(request.client.host if request.client else "")
    if not hub.admission.enter(person.account, address):
        raise Problem(429, "too_many", Message("too_many_pages")).with_headers(Retry_After="10")
    hub.admission.leave(person.account, address)
    if failed or "sec-websocket-version" in request.headers:
        hub.warn_of_proxy()
    problem = Problem(426, "upgrade_required", Message.of("websockets_not_passed", line=WEBSOCKET_LINES))
    raise problem.with_headers(Upgrade="websocket")


async def _serve(websocket: WebSocket, person: Person, language: str, hub: Hub) -> None:
    await websocket.accept()
    templates = templates_of(websocket)
    if language not in templates.languages:
        language = templates.language_of(websocket).tag
    browser = Browser(person.account, person.role.value, language)
    hub.join(browser)
    writing = asyncio.create_task(_write(websocket, browser))
    try:
        await _listen(websocket, browser, hub)
    except (WebSocketDisconnect, msgspec.DecodeError, TimeoutError, KeyError, RuntimeError):
        with suppress(WebSocketDisconnect, RuntimeError):
            await websocket.close()
    finally:
        hub.leave(browser)
        writing.cancel()


async def _write(websocket: WebSocket, browser: Browser) -> None:
    with suppress(WebSocketDisconnect, RuntimeError):
        while True:
            await _send(websocket, await browser.next())


async def _send(websocket: WebSocket, texts: list[str]) -> None:
    """Send texts, and keep none while the page waits for its next: a snapshot is up to 250 KiB."""
    for text in texts:
        await websocket.send_text(text)


async def _listen(websocket: WebSocket, browser: Browser, hub: Hub) -> None:
    """Read what a page sends, more slowly if it sends more than its share."""
    messages = Bucket(MESSAGES_A_SECOND, MAX_MESSAGES_AT_ONCE)
    snapshots = Bucket(SNAPSHOTS_A_SECOND, MAX_SNAPSHOTS_AT_ONCE)
    while True:
        async with asyncio.timeout(IDLE_TIMEOUT_S):
            text = await websocket.receive_text()
        if not messages.take(monotonic_now()):
            await asyncio.sleep(1 / MESSAGES_A_SECOND)
        wants_snapshot = _follow(hub, browser, text)
        del text  # up to 32 KiB of each open page, until its next message
        if wants_snapshot:
            if not snapshots.take(monotonic_now()):
                await asyncio.sleep(1 / SNAPSHOTS_A_SECOND)
            hub.send_snapshot(browser)


def _follow(hub: Hub, browser: Browser, text: str) -> bool:
    """Apply a message of a page; return whether it requests a snapshot too. Raises msgspec.DecodeError."""
    message = _decoder.decode(text)
    may_trace = Role(browser.role).includes(Role.ENGINEER)
    hub.follow(browser, message.units, message.trace if may_trace else "", lines=message.lines)
    return message.want == "snapshot"
