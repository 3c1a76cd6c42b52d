"""The WebSocket ``/live`` of an open page: it is told what changes; it asks for nothing but a snapshot.

Commands never come this way: what was clicked while a socket was down must never be sent later.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Annotated, Literal

import msgspec
from fastapi import APIRouter, WebSocket
from starlette.requests import HTTPConnection
from starlette.websockets import WebSocketDisconnect

from app.live.browser import Browser
from app.live.hub import Hub
from app.server.frames import outlet_of
from app.web.access import Role, Viewer
from app.web.templating import templates_of

router = APIRouter()

SILENCE_ENDS_S = 30.0
"""A page that says nothing for this long is gone; it speaks every ten seconds."""


class Said(msgspec.Struct, forbid_unknown_fields=True):
    """What a page may say. ``units``: the units it shows, as ``bus/unit``; ``trace``: a bus to follow, for an
    engineer, because whoever sees the frames sees every value that passed."""

    want: Literal["", "snapshot"] = ""
    units: Annotated[list[Annotated[str, msgspec.Meta(max_length=48)]], msgspec.Meta(max_length=512)] = []
    trace: Annotated[str, msgspec.Meta(max_length=40)] = ""


_decoder = msgspec.json.Decoder(Said)


def hub_of(connection: HTTPConnection) -> Hub:
    """The app's hub."""
    hub: Hub = connection.app.state.services.hub
    return hub


@router.websocket("/live")
async def live(websocket: WebSocket, person: Viewer, language: str = "") -> None:
    """One page from its opening to its end. ``language``: the page's own, so that both are the same."""
    await websocket.accept()
    templates = templates_of(websocket)
    if language not in templates.languages:
        language = templates.language_of(websocket).tag
    browser = Browser(person.account, person.role.value, language, outlet_of(websocket.scope))
    hub = hub_of(websocket)
    hub.join(browser)
    writing = asyncio.create_task(_write(websocket, browser))
    try:
        await _listen(websocket, browser, hub)
    except (WebSocketDisconnect, msgspec.DecodeError, TimeoutError, KeyError, RuntimeError):
        with suppress(RuntimeError):
            await websocket.close()
    finally:
        hub.leave(browser)
        writing.cancel()


async def _write(websocket: WebSocket, browser: Browser) -> None:
    with suppress(WebSocketDisconnect, RuntimeError):
        while True:
            for text in await browser.next():
                await websocket.send_text(text)


async def _listen(websocket: WebSocket, browser: Browser, hub: Hub) -> None:
    while True:
        async with asyncio.timeout(SILENCE_ENDS_S):
            said = _decoder.decode(await websocket.receive_text())
        if said.want == "snapshot":
            hub.send_snapshot(browser)
        units = frozenset(_unit(key) for key in said.units)
        trace = said.trace if Role(browser.role).includes(Role.ENGINEER) else ""
        if (units, trace) != (browser.units, browser.trace):
            hub.follow(browser, units, trace)


def _unit(key: str) -> tuple[str, int]:
    bus, _, number = key.rpartition("/")
    return (bus, int(number)) if number.isdecimal() and len(number) < 4 else ("", 0)
