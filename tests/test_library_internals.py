"""What we use of libraries beyond their public API is there, and no later version is installed unseen."""

from __future__ import annotations

import asyncio
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
import uvicorn
from babel import core, localedata
from fastapi import FastAPI
from fastapi.dependencies.utils import get_flat_params
from fastapi.routing import APIRoute, iter_route_contexts
from packaging.requirements import Requirement
from serialx.platforms.serial_rfc2217 import RFC2217Serial, RFC2217SerialTransport
from starlette.types import Receive, Scope, Send
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from uvicorn.server import ServerState

ROOT = Path(__file__).resolve().parents[1]
BOUNDED = ("babel", "uvicorn", "httptools", "websockets", "fastapi", "serialx")
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
    WebSocketsSansIOProtocol: "close_sent conn frames handshake_complete loop queue read_paused transport",
}


def made(kind: Callable[..., object]) -> object:
    async def app(_scope: Scope, _receive: Receive, _send: Send) -> None: ...

    return kind(uvicorn.Config(app), ServerState(), {})


@pytest.mark.parametrize(("kind", "names"), METHODS.items())
def test_overridden_members_exist(kind: type, names: str) -> None:
    gone = [name for name in names.split() if not callable(getattr(kind, name, None))]
    assert gone == [], f"{kind.__name__} has no {', '.join(gone)} any more. {HOW}"


@pytest.mark.parametrize(("kind", "names"), ATTRIBUTES.items())
async def test_used_members_exist(kind: type, names: str) -> None:
    protocol = made(kind)
    gone = [name for name in names.split() if not hasattr(protocol, name)]
    assert gone == [], f"{kind.__name__} has no {', '.join(gone)} any more. {HOW}"


def test_used_members_of_fastapi_exist() -> None:
    """Used by app.web.admission.routes and app.web.api.route: what a route declares, and its app."""
    app = FastAPI()

    @app.get("/units/{unit}")
    async def unit(unit: int, decimals: int = 0) -> None: ...

    route = next(route for route in app.routes if isinstance(route, APIRoute))
    assert [parameter.alias for parameter in get_flat_params(route.dependant)] == ["unit", "decimals"]
    assert [dependency.call for dependency in route.dependant.dependencies] == []
    assert callable(route.app)
    assert route.max_body_size is None
    assert [context.path for context in iter_route_contexts([route])] == ["/units/{unit}"]


def test_dropped_members_of_babel_exist() -> None:
    """Dropped by app.messages.locales, and read again by who wants them."""
    assert hasattr(core, "_global_data")
    assert isinstance(localedata._cache, dict)


def test_overridden_members_of_serialx_exist() -> None:
    names = ["_data_received", "_negotiate", "_send_and_wait", "_send_command"]
    gone = [name for name in names if not callable(getattr(RFC2217SerialTransport, name, None))]
    assert gone == [], f"RFC2217SerialTransport has no {', '.join(gone)} any more: bus/line/port/rfc2217.py"


async def test_used_and_replaced_members_of_serialx_exist() -> None:
    transport = RFC2217SerialTransport(asyncio.get_running_loop(), asyncio.Protocol())
    parts = {
        "_tcp_transport": transport,
        "_serial": transport,
        "_engine": RFC2217Serial(path="rfc2217://h:1"),
    }
    gone = [name for name, owner in parts.items() if not hasattr(owner, name)]
    assert gone == [], f"serialx has no {', '.join(gone)} any more: bus/line/port/rfc2217.py"
    assert callable(getattr(parts["_engine"]._engine, "feed", None)), (
        "the parser of serialx has no feed any more"
    )


def test_they_have_upper_bounds() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    stated = [*project["dependencies"], *project["optional-dependencies"]["rfc2217"]]
    bounds = {required.name: required.specifier for required in map(Requirement, stated)}
    open_ended = [name for name in BOUNDED if not any(each.operator == "<" for each in bounds[name])]
    assert open_ended == []
