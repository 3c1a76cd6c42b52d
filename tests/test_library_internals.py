"""What we use of libraries beyond their public API is there, and no later version is installed unseen."""

from __future__ import annotations

import asyncio
import inspect
import tomllib
from pathlib import Path

import uvicorn
from asyncua.common import connection
from asyncua.server import internal_session, uaprocessor
from asyncua.server.binary_server_asyncio import OPCUAProtocol
from babel import core, localedata
from fastapi import FastAPI
from fastapi.dependencies.utils import get_flat_params
from fastapi.routing import APIRoute
from packaging.requirements import Requirement
from serialx.platforms.serial_rfc2217 import RFC2217Serial, RFC2217SerialTransport
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from app.system.opcua import gate

ROOT = Path(__file__).resolve().parents[1]
BOUNDED = ("babel", "uvicorn", "httptools", "websockets", "fastapi", "serialx", "asyncua")
OPCUA = "read docs/decisions/0053-opcua-in-a-process.md"
HOW = "read what replaced it, then docs/decisions/0008-gate.md"


def test_overridden_methods_of_uvicorn_exist() -> None:
    gone = [
        name for name in ("startup", "capture_signals") if not callable(getattr(uvicorn.Server, name, None))
    ]
    assert gone == [], f"uvicorn.Server has no {', '.join(gone)} any more: {HOW}"


def test_a_protocol_of_uvicorn_is_made_by_name() -> None:
    """Made and called by app.core.server.gate, as by uvicorn itself."""
    made_by = inspect.signature(HttpToolsProtocol).parameters
    assert [*made_by] == ["config", "server_state", "app_state", "_loop"], HOW
    assert issubclass(HttpToolsProtocol, asyncio.Protocol), HOW


def test_used_members_of_fastapi_exist() -> None:
    """What a route declares, and its app: app.core.web.routes and app.core.web.api use it."""
    app = FastAPI()

    @app.get("/units/{unit}")
    async def unit(unit: int, decimals: int = 0) -> None: ...

    route = next(route for route in app.routes if isinstance(route, APIRoute))
    assert [parameter.alias for parameter in get_flat_params(route.dependant)] == ["unit", "decimals"]
    assert [dependency.call for dependency in route.dependant.dependencies] == []
    assert callable(route.app)
    assert route.max_body_size is None


def test_dropped_members_of_babel_exist() -> None:
    """Dropped by app.core.messages.languages, and read again by who wants them."""
    assert hasattr(core, "_global_data")
    assert isinstance(localedata._cache, dict)


def test_overridden_methods_of_asyncua_exist() -> None:
    """Overridden by app.system.opcua.gate: one that asyncua does not call any more would bound nothing."""
    called = "".join(map(inspect.getsource, (uaprocessor, connection, internal_session)))
    for ours in (gate.ViewerSession, gate.ViewerServer, gate.TrustedPolicy, gate.Tokens, gate.ReadOnly):
        inherited = {name for base in ours.__mro__[1:] for name in vars(base)}
        overridden = {name for name in vars(ours) if name in inherited and not name.startswith("_")}
        missing = [name for name in overridden if f".{name}(" not in called]
        assert overridden, ours
        assert missing == [], f"asyncua does not call {missing} of {ours.__name__}: {OPCUA}"


def test_a_connection_of_asyncua_is_made_by_name() -> None:
    made_by = inspect.signature(OPCUAProtocol).parameters
    assert [*made_by] == ["iserver", "policies", "clients", "closing_tasks", "limits"], OPCUA
    assert issubclass(OPCUAProtocol, asyncio.Protocol), OPCUA


def test_overridden_members_of_serialx_exist() -> None:
    names = ["_data_received", "_negotiate", "_send_and_wait", "_send_command"]
    gone = [name for name in names if not callable(getattr(RFC2217SerialTransport, name, None))]
    assert gone == [], f"RFC2217SerialTransport has no {', '.join(gone)} any more: bus/line/device_server.py"


async def test_used_and_replaced_members_of_serialx_exist() -> None:
    transport = RFC2217SerialTransport(asyncio.get_running_loop(), asyncio.Protocol())
    parts = {
        "_tcp_transport": transport,
        "_serial": transport,
        "_engine": RFC2217Serial(path="rfc2217://h:1"),
    }
    gone = [name for name, owner in parts.items() if not hasattr(owner, name)]
    assert gone == [], f"serialx has no {', '.join(gone)} any more: bus/line/device_server.py"
    assert callable(getattr(parts["_engine"]._engine, "feed", None)), (
        "the parser of serialx has no feed any more"
    )


def test_they_have_upper_bounds() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    stated = [
        *project["dependencies"],
        *(each for extra in ("rfc2217", "opcua") for each in project["optional-dependencies"][extra]),
    ]
    bounds = {required.name: required.specifier for required in map(Requirement, stated)}
    open_ended = [name for name in BOUNDED if not any(each.operator == "<" for each in bounds[name])]
    assert open_ended == []
