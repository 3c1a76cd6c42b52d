"""What we use of libraries beyond their public API is there, and no later version is installed unseen."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
import uvicorn
from packaging.requirements import Requirement
from starlette.types import Receive, Scope, Send
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from uvicorn.server import ServerState

ROOT = Path(__file__).resolve().parents[1]
BOUNDED = ("uvicorn", "httptools", "websockets", "serialx")
HOW = "app/server overrides it: read what replaced it, then docs/decisions/0008-uvicorn-internals.md"

METHODS: dict[type, str] = {
    HttpToolsProtocol: (
        "connection_made connection_lost data_received resume_writing send_400_response on_message_begin "
        "on_url on_header on_headers_complete on_body on_message_complete on_response_complete "
        "handle_websocket_upgrade"
    ),
    RequestResponseCycle: "run_asgi send receive",
    WebSocketsSansIOProtocol: (
        "connection_made connection_lost data_received resume_writing handle_connect handle_text "
        "handle_bytes handle_cont handle_ping handle_pong handle_parser_exception run_asgi send receive"
    ),
    uvicorn.Server: "startup shutdown main_loop on_tick capture_signals",
}
ATTRIBUTES: dict[type, str] = {
    HttpToolsProtocol: "client config cycle flow headers loop pipeline scope transport ws_protocol_class",
    WebSocketsSansIOProtocol: "close_sent handshake_complete loop queue transport",
}


def made(kind: Callable[..., object]) -> object:
    async def app(_scope: Scope, _receive: Receive, _send: Send) -> None: ...

    return kind(uvicorn.Config(app), ServerState(), {})


@pytest.mark.parametrize(("kind", "names"), METHODS.items())
def test_what_is_overridden_is_there(kind: type, names: str) -> None:
    gone = [name for name in names.split() if not callable(getattr(kind, name, None))]
    assert gone == [], f"{kind.__name__} has no {', '.join(gone)} any more. {HOW}"


@pytest.mark.parametrize(("kind", "names"), ATTRIBUTES.items())
async def test_what_is_read_is_there(kind: type, names: str) -> None:
    protocol = made(kind)
    gone = [name for name in names.split() if not hasattr(protocol, name)]
    assert gone == [], f"{kind.__name__} has no {', '.join(gone)} any more. {HOW}"


def test_they_have_upper_bounds() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    stated = [*project["dependencies"], *project["optional-dependencies"]["rfc2217"]]
    bounds = {required.name: required.specifier for required in map(Requirement, stated)}
    open_ended = [name for name in BOUNDED if not any(each.operator == "<" for each in bounds[name])]
    assert open_ended == []
