"""The worker as a process: its event loop, its signals, its log, and that it dies with its parent."""

from __future__ import annotations

import asyncio
import gc
import os
import signal
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

import uvloop

from bus.settings import BusSettings
from bus.worker.log import configure_log
from bus.worker.parent import named_parent, tie_to
from bus.worker.service import run_worker

if TYPE_CHECKING:
    from bus.worker.uplink_tls import UplinkTls

PRIORITY = -10
"""The worker sleeps 97 % of the time; when a response is complete its next request is due at once."""


def run(
    bus: BusSettings,
    apps: Sequence[str],
    token: str,
    *,
    child: bool = False,
    tls: UplinkTls | None = None,
) -> int:
    """Run one worker until SIGTERM or SIGINT, a ``child`` also until its parent is gone; the exit code."""
    configure_log()
    if child:
        tie_to(named_parent() or os.getppid())
    # A busy machine must not leave the wire idle: go before others where the system allows it, and keep
    # what is loaded out of every garbage collection.
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, PRIORITY)
    gc.collect()
    gc.freeze()
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(_until_stopped(bus, apps, token, tls))
    return 0


async def _until_stopped(bus: BusSettings, apps: Sequence[str], token: str, tls: UplinkTls | None) -> None:
    leave = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, leave.set)
    await run_worker(bus, apps, token, leave=leave, tls=tls)
