"""The bus workers as child processes: started, replaced when one dies or does not respond, ended in time."""

from __future__ import annotations

import asyncio
import os
import random
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

import structlog

from app.cli.serving.watchdog import LOOK_S, Watchdog
from bus.instants import Monotonic, monotonic_now
from bus.pacing import ReconnectDelay
from bus.worker.process import tied_environment

log = structlog.get_logger()

MAX_PAUSE_S = 5.0
MAX_UNWATCHED_S = 2 * MAX_PAUSE_S
GRACE_S = 2.3
"""A worker finishes or withdraws the change in flight and leaves within 2 s of SIGTERM."""


class WorkerProcesses:
    """One child for each bus, over the same WebSocket as a worker far away. ``tokens``: by bus, what its
    child opens the feed with."""

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
        """Start them all, and keep them."""
        for bus in self._tokens:
            task = asyncio.create_task(self._keep(bus), name=f"keep worker of {bus}")
            task.add_done_callback(_log_failure)
            self._tasks[bus] = task

    def watch(self, responds: Callable[[str], bool]) -> None:
        """Kill each worker that does not respond from now on; another is started. ``responds``: whether the
        worker of a bus did since the last call."""
        self._responds = responds

    def are_kept(self) -> bool:
        """Whether every worker was looked at lately, or is about to be started again."""
        now = monotonic_now()
        return all(now - self._looked_at.get(bus, now) < MAX_UNWATCHED_S for bus in self._tasks)

    async def stop_all(self) -> None:
        """End them all: by SIGTERM, and by SIGKILL after the grace."""
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
        """Start one, watch it and wait for its end; return its exit code."""
        called = ["-P", "-m", "bus", "--config", str(self._config), "--bus", bus, "--app", self._app_url]
        # In its own process group: Ctrl-C reaches it through the parent.
        process = await asyncio.create_subprocess_exec(
            sys.executable, *called, "--child", stdin=PIPE, env=self._environment, preexec_fn=os.setpgrp
        )
        self._processes[bus] = process
        # Unlike arguments and environment, no listing of processes shows what passes through a pipe.
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
                # A stopped process acts on no other signal. Its end frees the port.
                process.kill()


def _log_failure(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and task.exception():
        log.error("a bus worker is kept no longer", task=task.get_name(), exc_info=task.exception())


async def end(process: Process, grace_s: float) -> None:
    """SIGTERM, and SIGKILL after the grace."""
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
