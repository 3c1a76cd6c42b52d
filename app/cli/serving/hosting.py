"""The dashboard and its workers from the first moment to the last."""

from __future__ import annotations

import asyncio
import fcntl
import os
import secrets
import signal
import socket
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import structlog
import uvloop
from pydantic import BaseModel
from pydantic.warnings import UnsupportedFieldAttributeWarning

from app.cli import loading
from app.cli.ending import report
from app.cli.serving.listening import listen, url_of
from app.cli.serving.workers import WorkerProcesses
from app.cli.setup.rights import become_owner_of
from app.core.database import Database
from app.core.database.files import make_folder
from app.core.messages.languages import catalogs, locale_of
from app.core.server.service_manager import Liveness, ServiceManager
from app.errors import system_error
from app.settings import LOCK_FILE, Settings
from app.version import VERSION
from bus.errors import LinesideError
from bus.instants import Monotonic
from bus.messages import Message
from bus.worker.process import configure_log

SWITCH_S = 0.001
"""How long a thread that computes (a parameter set, a search, an export) keeps the interpreter from the event
loop, each time that the loop has polled its sockets."""
DATA_IN_USE = "data_in_use"
_ENDINGS = (signal.SIGTERM, signal.SIGINT)


class HostingError(LinesideError):
    """The dashboard could not begin to serve."""


@contextmanager
def only_one(data: Path) -> Iterator[None]:
    """Two servers on one folder of data would write the same store. Raises HostingError."""
    try:
        make_folder(data)
        lock = os.open(data / LOCK_FILE, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    except OSError as error:
        reason = system_error(error)
        raise HostingError(Message.of("data_not_writable", folder=str(data), error=reason)) from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError as error:
        raise HostingError(Message.of(DATA_IN_USE, folder=str(data))) from error
    finally:
        os.close(lock)


def host(
    settings: Settings,
    config: Path,
    listening: socket.socket,
    manager: ServiceManager,
    since: Monotonic,
    *,
    demo: bool = False,
) -> bool:
    """Serve at ``listening`` until SIGTERM or SIGINT, or until a person restarts the server: then True.
    ``since``: when the first client can have connected. Raises HostingError and StoreError in words."""
    rights = os.geteuid()
    become_owner_of(settings.server.data)
    can_restart = os.geteuid() == rights and settings.server.port != 0 and not demo
    configure_log()
    structlog.get_logger().info("lineside", version=VERSION)
    sys.setswitchinterval(SWITCH_S)
    # Its own workers never depend on a certificate: it may expire while they run.
    is_encrypted = settings.server.tls is not None
    own = listen("127.0.0.1", 0, Message("choose_port")) if is_encrypted else nullcontext(None)
    with only_one(settings.server.data), own as feed:
        hosting = _host(settings, config, listening, feed, manager, since, demo=demo, restarts=can_restart)
        return uvloop.run(hosting)


async def _host(
    settings: Settings,
    config: Path,
    listening: socket.socket,
    feed: socket.socket | None,
    manager: ServiceManager,
    since: Monotonic,
    *,
    demo: bool,
    restarts: bool,
) -> bool:
    """The workers begin while the dashboard is still being read, and end before it does. ``feed``: where they
    find it; None: where browsers do; ``restarts``: whether a person may restart it. Return
    whether one has."""
    address, port = listening.getsockname()[:2]
    url = url_of(address, port, "http" if feed is None else "https")
    feed_url = url_of(*(feed or listening).getsockname()[:2])
    # Not by app.people.auth: it imports FastAPI, and the workers start before that takes its time.
    tokens = {bus.name: secrets.token_urlsafe(32) for bus in settings.bus if bus.worker == "server"}
    workers = WorkerProcesses(config, tokens, feed_url)
    stopping, restart = _stop_requested(), asyncio.Event()
    workers.start_all()
    try:
        with loading():
            if (module := await _server_module(stopping)) is None:
                return False
            server = module.Server(
                settings, demo, tokens, partial(_report_serving, url, manager), since, feed
            )
        workers.watch(server.worker_responds)
        server.each_second(Liveness(manager, server.services[Database], workers.are_kept).tick)
        if restarts:
            restart = server.offer_restart()
        restarting = asyncio.create_task(restart.wait())
        serving = asyncio.create_task(server.serve([listening]))
        await asyncio.wait({serving, stopping, restarting}, return_when=asyncio.FIRST_COMPLETED)
        restarting.cancel()
    finally:
        stopping.cancel()
        if restart.is_set():
            manager.restarting()
        else:
            manager.stopping()
        await workers.stop_all()
    server.end()
    await serving
    if not server.started:
        raise HostingError(Message("dashboard_not_started"))
    return restart.is_set()


def _report_serving(url: str, manager: ServiceManager, code: str) -> None:
    """``code``: for the first admin; empty where there is a user."""
    manager.ready(f"serving at {url}")
    report(Message.of("dashboard_at", url=url))
    if code:
        report(Message.of("first_admin_code", url=url, code=code))


async def _server_module(stopping: asyncio.Task[Any]) -> Any:
    """The dashboard's code; None where ``stopping`` came first. Beside many workers that start too,
    importing it takes a minute on a small machine: they must not go on for so long."""
    reading = asyncio.create_task(asyncio.to_thread(_import_server))
    await asyncio.wait({reading, stopping}, return_when=asyncio.FIRST_COMPLETED)
    return None if stopping.done() else await reading


def _import_server() -> Any:
    # FastAPI describes OpenAPI by 82 models, 1.2 MiB: they are built for who reads the description.
    BaseModel.model_config["defer_build"] = True
    # FastAPI silences it where it makes a model, which is now built later.
    warnings.filterwarnings("ignore", category=UnsupportedFieldAttributeWarning)
    # First, so that what is imported fills the memory of what Babel reads and `locale_of` leaves out.
    for path in catalogs().values():
        locale_of(path.stem)
    return import_module("app.cli.serving.server")


def _stop_requested() -> asyncio.Task[Any]:
    """Done once SIGTERM or SIGINT has come."""
    ending = asyncio.Event()
    for number in _ENDINGS:
        asyncio.get_running_loop().add_signal_handler(number, ending.set)
    return asyncio.create_task(ending.wait())
