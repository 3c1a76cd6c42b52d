"""The worker as a process: its event loop, its signals, its log, and that it dies with its parent."""

from __future__ import annotations

import asyncio
import ctypes
import gc
import os
import signal
from contextlib import suppress
from typing import Any

import uvloop

from bus.settings import BusSettings
from bus.worker.log import configure_log
from bus.worker.service import run_worker

_PR_SET_PDEATHSIG = 1
PARENT_CHECK_S = 0.5
PRIORITY = -10
"""The worker sleeps 97 % of the time; when an answer is complete its next request is due at once."""
PARENT_VARIABLE = "LINESIDE_PARENT"
"""Who started this process: by the time it can ask the kernel, that one may be gone already."""


def run(bus: BusSettings, app_url: str, token: str, *, child: bool = False) -> int:
    """Run one worker until SIGTERM or SIGINT; ``child``: also until the parent process is gone.

    Gives the exit code.
    """
    configure_log()
    parent = int(os.environ.get(PARENT_VARIABLE, os.getppid()))
    if child:
        _die_with_parent()
    _be_prompt()
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(_until_told(bus, app_url, token, parent if child else None))
    return 0


async def _until_told(bus: BusSettings, app_url: str, token: str, parent: int | None) -> None:
    leave = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, leave.set)
    watching = asyncio.create_task(_leave_with(parent, leave)) if parent is not None else None
    try:
        await run_worker(bus, app_url, token, leave=leave)
    finally:
        if watching is not None:
            watching.cancel()


async def _leave_with(parent: int, leave: asyncio.Event) -> None:
    """The parent may have died before the kernel was asked to tell."""
    while not leave.is_set():
        if os.getppid() != parent:
            leave.set()
        await asyncio.sleep(PARENT_CHECK_S)


def _be_prompt() -> None:
    """A busy machine must not leave the wire idle: go before others where the system allows it, and keep
    what is loaded out of every garbage collection.
    """
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, PRIORITY)
    gc.collect()
    gc.freeze()


def _die_with_parent() -> None:
    prctl: Any = getattr(ctypes.CDLL(None), "prctl", None)
    if prctl is not None:
        prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
