"""The dashboard and its workers from the first moment to the last."""

from __future__ import annotations

import asyncio
import errno
import fcntl
import os
import signal
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import typer
import uvloop

from app.auth.rules import new_secret
from app.cli.loading import loading
from app.cli.workers import Workers
from app.settings import Server, Settings
from bus.errors import LinesideError
from bus.worker.log import configure_log

BACKLOG = 512
"""Browsers of a whole plant come back at once after a restart."""
_ENDINGS = (signal.SIGTERM, signal.SIGINT)


class HostingError(LinesideError):
    """The dashboard could not begin to serve."""


def listen(server: Server) -> socket.socket:
    """Take the TCP port. Raises HostingError in words."""
    family = socket.AF_INET6 if ":" in server.host else socket.AF_INET
    both = server.host == "::" and socket.has_dualstack_ipv6()
    try:
        return socket.create_server(
            (server.host, server.port), family=family, backlog=BACKLOG, dualstack_ipv6=both
        )
    except (OSError, OverflowError) as error:
        raise HostingError(_why_not(server, error)) from error


def _why_not(server: Server, error: Exception) -> str:
    where = f"port {server.port} of {server.host}"
    match getattr(error, "errno", None):
        case errno.EADDRINUSE:
            return f"{where} is taken by another program; end it, or choose another port for the dashboard"
        case errno.EACCES:
            return f"{where} is not for this user; choose a port above 1023"
        case _:
            words = getattr(error, "strerror", None) or error
            return f"{where} cannot be opened: {words}; check host and port of the dashboard"


def url_of(listening: socket.socket) -> str:
    """Where a browser or a worker on this machine finds the dashboard."""
    host, port = listening.getsockname()[:2]
    if host in ("0.0.0.0", "::"):
        host = "127.0.0.1"
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


@contextmanager
def only_one(data: Path) -> Iterator[None]:
    """Two servers on one folder of data would write the same store. Raises HostingError."""
    lock = _lock_file(data)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError as error:
        raise HostingError(
            f"another Lineside server uses {data}; end it, or give this one its own"
        ) from error
    finally:
        os.close(lock)


def _lock_file(data: Path) -> int:
    try:
        data.mkdir(parents=True, exist_ok=True)
        return os.open(data / "lock", os.O_RDWR | os.O_CREAT, 0o600)
    except OSError as error:
        raise HostingError(
            f"nothing can be written to {data}: {error.strerror}; give the server's user write access to it, "
            "or name another folder as data in [server]"
        ) from error


def host(settings: Settings, config: Path, *, demo: bool = False) -> None:
    """Serve until SIGTERM or SIGINT. Raises HostingError and StoreError in words."""
    configure_log()
    with listen(settings.server) as listening, only_one(settings.server.data):
        uvloop.run(_host(settings, config, listening, demo=demo))


async def _host(settings: Settings, config: Path, listening: socket.socket, *, demo: bool) -> None:
    """The workers begin while the dashboard is still being read, and end before it does."""
    url, tokens = url_of(listening), {bus.name: new_secret() for bus in settings.bus}
    workers = Workers(config, tokens, url)
    asked = _ending_asked()
    workers.start()
    try:
        with loading():
            if (module := await _server_module(asked)) is None:
                return
            server = module.Server(settings, demo, tokens, lambda: typer.echo(f"Lineside: {url}"))
        serving = asyncio.create_task(server.serve([listening]))
        await asyncio.wait({serving, asked}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        asked.cancel()
        await workers.stop()
    server.end()
    await serving
    if not server.started:
        raise HostingError("the dashboard could not begin; what stands above says why")


async def _server_module(asked: asyncio.Task[Any]) -> Any:
    """The dashboard's code; None where the end was ``asked`` meanwhile. Beside many workers that begin too,
    reading it takes a minute on a small machine: they must not go on for so long."""
    reading = asyncio.create_task(asyncio.to_thread(import_module, "app.cli.server"))
    await asyncio.wait({reading, asked}, return_when=asyncio.FIRST_COMPLETED)
    return None if asked.done() else await reading


def _ending_asked() -> asyncio.Task[Any]:
    """Done once SIGTERM or SIGINT has come."""
    ending = asyncio.Event()
    for number in _ENDINGS:
        asyncio.get_running_loop().add_signal_handler(number, ending.set)
    return asyncio.create_task(ending.wait())
