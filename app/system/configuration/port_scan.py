"""The serial ports of this machine, and a scan of a port without a bus by ``lineside scan``."""

from __future__ import annotations

import asyncio
import json
import sys
from asyncio.subprocess import DEVNULL, PIPE
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec

from app.errors import Problem
from bus.messages import Message

BY_ID = Path("/dev/serial/by-id")
DEVICES = Path("/dev")
OPTIONS = ("--json",)


def adapters(folder: Path = BY_ID) -> list[str]:
    """Return the serial adapters of this machine by their lasting paths."""
    return sorted(str(entry) for entry in folder.iterdir()) if folder.is_dir() else []


def ports(by_id: Path = BY_ID, devices: Path = DEVICES) -> list[str]:
    """Return the ports that a bus may use: adapters by their lasting paths, else by their present names; then
    built-in ports."""
    plugged = adapters(by_id) or sorted(
        str(each) for kind in ("ttyUSB", "ttyACM") for each in devices.glob(f"{kind}*")
    )
    return [*plugged, *(str(each) for each in sorted(devices.glob("ttyS[0-3]")))]


class PortScan:
    """The scan of a port, one at a time, in a process of its own: the server opens no port. ``found``: the
    resulting ``[[bus]]``; ``fault``: why there is none."""

    def __init__(self) -> None:
        self.port = ""
        self.found: dict[str, Any] | None = None
        self.fault: Message | None = None
        self._task: asyncio.Task[None] | None = None

    @property
    def is_running(self) -> bool:
        return self._task is not None and not self._task.done()

    def start(self, port: str) -> None:
        """Begin a scan; forget the result of the former. Raise Problem 409 while one runs."""
        if self.is_running:
            raise Problem(409, "not_in_state", Message.of("port_scan_runs", port=self.port))
        self.port, self.found, self.fault = port, None, None
        self._task = asyncio.create_task(self._scan(port))

    def refuse(self, port: str, fault: Message) -> None:
        """Note why a port is not scanned. Do nothing while a scan runs."""
        if not self.is_running:
            self.port, self.found, self.fault = port, None, fault

    async def stop(self) -> None:
        """End the scan, if one runs; the port is free when this returns."""
        if self._task is not None:
            self._task.cancel()
            with suppress(asyncio.CancelledError):
                await self._task

    async def _scan(self, port: str) -> None:
        words = ("-P", "-m", "app.cli", "scan", f"--port={port}", *OPTIONS)
        process = await asyncio.create_subprocess_exec(
            sys.executable, *words, stdin=DEVNULL, stdout=PIPE, stderr=PIPE
        )
        try:
            output, errors = await process.communicate()
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        try:
            document = json.loads(output)
        except ValueError:  # it ended early, such as for lack of memory
            *_, reason = errors.decode(errors="replace").splitlines() or [f"exit code {process.returncode}"]
            self.fault = Message.of("port_scan_failed", reason=reason)
            return
        if document["failure"] is None:
            self.found = document["bus"]
        else:
            failure = msgspec.convert(document["failure"], Message)
            self.fault = Message.of("port_scan_failed", reason=failure)
