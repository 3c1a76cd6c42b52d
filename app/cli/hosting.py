"""The run of the dashboard and its bus workers, from start to end."""

from __future__ import annotations

import asyncio
import ctypes
import fcntl
import os
import random
import secrets
import signal
import socket
import sys
import warnings
from asyncio.subprocess import PIPE, Process
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import structlog
import uvloop
from pydantic import BaseModel
from pydantic.warnings import UnsupportedFieldAttributeWarning

from app.cli import loading
from app.cli.command import become_owner_of, report
from app.cli.starting import listen, url_of
from app.core.database import Database
from app.core.database.files import make_folder
from app.core.lifespan import in_thread
from app.core.messages.languages import catalogs, locale_of
from app.core.server.service_manager import Liveness, ServiceManager
from app.errors import system_error
from app.settings import LOCK_FILE, Settings
from app.version import VERSION
from bus.errors import LinesideError
from bus.instants import Monotonic, monotonic_now
from bus.messages import Message
from bus.pacing import ReconnectDelay
from bus.worker.process import configure_log, tied_environment

SWITCH_S = 0.001
"""The time for which a computing thread (a parameter set, a search, an export) keeps the interpreter from the
event loop, each time that the loop has polled its sockets."""
M_ARENA_MAX = -8
"""The parameter of glibc's mallopt (malloc.h) for the number of heaps."""
DATA_IN_USE = "data_in_use"
_ENDINGS = (signal.SIGTERM, signal.SIGINT)
log = structlog.get_logger()
MAX_PAUSE_S = 5.0
MAX_UNWATCHED_S = 2 * MAX_PAUSE_S
GRACE_S = 2.3
"""A worker finishes or withdraws the change in flight and ends within 2 s of SIGTERM."""
LOOK_S = 1.0
MAX_MISSED = 10
"""The looks without a response after which a worker is given up. They begin 5 s after the last message, when
the feed gives a worker up; opening a port takes far less."""
MAX_MISSED_AT_START = 120
"""The same before the first response: on a small machine many workers import code at once."""


class HostingError(LinesideError):
    """Raised if the dashboard could not begin to serve."""


@contextmanager
def only_one(data: Path) -> Iterator[None]:
    """Lock the data folder: two servers on one folder would write the same store. Raise HostingError."""
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
    """Serve at ``listening`` until SIGTERM, SIGINT or a restart; return whether a person requested a restart.
    ``since``: the time from which a client can have connected. Raise HostingError or StoreError."""
    rights = os.geteuid()
    become_owner_of(settings.server.data)
    can_restart = os.geteuid() == rights and settings.server.port != 0 and not demo
    configure_log()
    structlog.get_logger().info("lineside", version=VERSION)
    sys.setswitchinterval(SWITCH_S)
    _share_one_heap()
    # The server's workers never depend on a certificate: it may expire while they run.
    is_encrypted = settings.server.tls is not None
    own = listen("127.0.0.1", 0, Message("choose_port")) if is_encrypted else nullcontext(None)
    with only_one(settings.server.data), own as feed:
        hosting = _host(settings, config, listening, feed, manager, since, demo=demo, restarts=can_restart)
        return uvloop.run(hosting)


def _share_one_heap() -> None:
    """Let all threads allocate from one heap: glibc gives each thread a heap, which keeps freed memory, 2 MiB
    in all. Python's threads take turns anyway."""
    with suppress(AttributeError):  # only glibc has mallopt
        ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)


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
    """Run the workers and the dashboard: the workers begin while the dashboard's code is still being
    imported, and end before the dashboard. ``feed``: the port of the workers, None if they use that of
    browsers; ``restarts``: whether a person may restart the server. Return whether one has."""
    address, port = listening.getsockname()[:2]
    url = url_of(address, port, "http" if feed is None else "https")
    feed_url = url_of(*(feed or listening).getsockname()[:2])
    # This is not in app.people.auth: that imports FastAPI, and the workers start before its import.
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
        if manager.is_there:
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
    """Report that the dashboard serves. ``code``: for the first admin; empty if a user exists."""
    manager.ready(f"serving at {url}")
    report(Message.of("dashboard_at", url=url))
    if code:
        report(Message.of("first_admin_code", url=url, code=code))


async def _server_module(stopping: asyncio.Task[Any]) -> Any:
    """Import the dashboard's code; return None if ``stopping`` came first. Beside many workers that start
    too, the import takes a minute on a small machine: a request to stop must not wait for it."""
    reading = asyncio.create_task(in_thread(_import_server))
    await asyncio.wait({reading, stopping}, return_when=asyncio.FIRST_COMPLETED)
    return None if stopping.done() else await reading


def _import_server() -> Any:
    # FastAPI describes OpenAPI by 82 models, 1.2 MiB: they are built when a user reads the description.
    BaseModel.model_config["defer_build"] = True
    # FastAPI silences this warning where it makes a model, which is now built later.
    warnings.filterwarnings("ignore", category=UnsupportedFieldAttributeWarning)
    # Import this first: later imports then reuse the memory of what `locale_of` drops of Babel's data.
    for path in catalogs().values():
        locale_of(path.stem)
    return import_module("app.cli.server")


def _stop_requested() -> asyncio.Task[Any]:
    """Return a task that is done once SIGTERM or SIGINT has come."""
    ending = asyncio.Event()
    for number in _ENDINGS:
        asyncio.get_running_loop().add_signal_handler(number, ending.set)
    return asyncio.create_task(ending.wait())


class WorkerProcesses:
    """The bus workers as child processes, each connected by the same WebSocket as a remote worker.
    ``tokens``: the token with which the worker of a bus opens the feed, by bus."""

    def __init__(self, config: Path, tokens: Mapping[str, str], app_url: str) -> None:
        self._config = config
        self._tokens = tokens
        self._app_url = app_url
        self._environment = tied_environment()
        self._processes: dict[str, Process] = {}
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._responds: Callable[[str], bool] | None = None
        self._looked_at: dict[str, Monotonic] = {}

    def start_all(self) -> None:
        """Start all workers; a worker that ends is started again."""
        for bus in self._tokens:
            task = asyncio.create_task(self._keep(bus), name=f"keep worker of {bus}")
            task.add_done_callback(_log_failure)
            self._tasks[bus] = task

    def watch(self, responds: Callable[[str], bool]) -> None:
        """Kill each worker that does not respond from now on; another is started. ``responds``: whether a
        bus's worker has responded since the last call."""
        self._responds = responds

    def are_kept(self) -> bool:
        """Return whether every worker was checked recently, or is about to be started again."""
        now = monotonic_now()
        return all(now - self._looked_at.get(bus, now) < MAX_UNWATCHED_S for bus in self._tasks)

    async def stop_all(self) -> None:
        """End all workers: by SIGTERM, and by SIGKILL after the grace period."""
        await asyncio.gather(*map(self._stop, tuple(self._tasks)))

    async def _stop(self, bus: str) -> None:
        task = self._tasks.pop(bus, None)
        if task is None:
            return
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        process = self._processes.pop(bus, None)
        if process is not None:
            await end(process, GRACE_S)

    async def _keep(self, bus: str) -> None:
        delay = ReconnectDelay(random.random)
        while True:
            self._looked_at[bus] = started = monotonic_now()
            code = await self._run(bus)
            pause = min(delay.ended(monotonic_now() - started), MAX_PAUSE_S)
            log.warning("bus worker ended, starts again", bus=bus, code=code, after_s=round(pause, 1))
            await asyncio.sleep(pause)

    async def _run(self, bus: str) -> int:
        """Start a worker, watch it and wait for its end; return its exit code."""
        called = ["-P", "-m", "bus", "--config", str(self._config), "--bus", bus, "--app", self._app_url]
        # It has its own process group: Ctrl-C reaches it through the parent.
        process = await asyncio.create_subprocess_exec(
            sys.executable, *called, "--child", stdin=PIPE, env=self._environment, preexec_fn=os.setpgrp
        )
        self._processes[bus] = process
        # Unlike arguments and environment, data in a pipe shows in no listing of processes.
        assert process.stdin is not None
        process.stdin.write(f"{self._tokens[bus]}\n".encode())
        process.stdin.close()
        watchdog = Watchdog()
        while True:
            self._looked_at[bus] = monotonic_now()
            with suppress(TimeoutError):
                async with asyncio.timeout(LOOK_S):
                    return await process.wait()
            if self._responds is not None and watchdog.expires(responds=self._responds(bus)):
                log.error("bus worker does not respond, killed", bus=bus, after_looks=watchdog.missed)
                # A stopped process reacts to no other signal. Its end frees the port.
                process.kill()


def _log_failure(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and task.exception():
        log.error("a bus worker is kept no longer", task=task.get_name(), exc_info=task.exception())


async def end(process: Process, grace_s: float) -> None:
    """End a process by SIGTERM, and by SIGKILL after the grace period."""
    if process.returncode is not None:
        return
    with suppress(ProcessLookupError):
        process.terminate()
    try:
        async with asyncio.timeout(grace_s):
            await process.wait()
    except TimeoutError:
        with suppress(ProcessLookupError):
            process.kill()
        await process.wait()


# watchdog


@dataclass(slots=True)
class Watchdog:
    """A watchdog that decides when a process that does not respond is given up. It counts looks, not seconds,
    so that a stall of the observer does not count as a stall of the process. Pure."""

    missed: int = 0
    limit: int = MAX_MISSED_AT_START
    has_looked: bool = False

    def expires(self, *, responds: bool) -> bool:
        """Look once; return whether the process has been without a response for too long."""
        if not self.has_looked:
            # The response may have come from the process before.
            self.has_looked = True
        elif responds:
            self.missed, self.limit = 0, MAX_MISSED
        else:
            self.missed += 1
        return self.missed >= self.limit
