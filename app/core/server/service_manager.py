"""Tells systemd how the server is: that it serves, what it waits for, that it goes on (sd_notify(3)).

A datagram to the socket that ``NOTIFY_SOCKET`` names; nothing where there is none.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping, MutableMapping
from contextlib import suppress

from bus.instants import Monotonic

NOTIFY_SOCKET = "NOTIFY_SOCKET"


class ServiceManager:
    """Sends to the socket of the environment, which the processes that are started here do not inherit."""

    def __init__(self, environment: MutableMapping[str, str] = os.environ) -> None:
        address = environment.pop(NOTIFY_SOCKET, "")
        # An abstract address is written with @ in place of its first byte, which is 0.
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        self.is_there = bool(address)

    def ready(self, status: str) -> None:
        """Tell systemd that the server responds. ``status``: a line for ``systemctl status``."""
        self._send("READY=1", f"STATUS={status}")

    def alive(self) -> None:
        """Tell systemd that every part has moved on: its watchdog begins its time again."""
        self._send("WATCHDOG=1")

    def restarting(self, environment: MutableMapping[str, str] = os.environ) -> None:
        """Tell systemd that the server starts again in this process, which finds the socket in its
        environment."""
        self._send("RELOADING=1", "STATUS=restarts with the changed configuration")
        if self.is_there:
            environment[NOTIFY_SOCKET] = self._address.replace("\0", "@", 1)

    def stopping(self) -> None:
        self._send("STOPPING=1")

    def _send(self, *lines: str) -> None:
        if not self.is_there:
            return
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sending:
            # A manager that is busy or gone learns it the next time.
            sending.setblocking(False)
            sending.sendto("\n".join(lines).encode(), self._address)


class PartsProgress:
    """Whether every part moves on, from ``now`` on. ``max_still_s``: how long each may not. Pure."""

    def __init__(self, max_still_s: Mapping[str, float], now: Monotonic) -> None:
        self._max_still_s = max_still_s
        self._at = dict.fromkeys(max_still_s, now)

    def moved(self, part: str, now: Monotonic) -> None:
        self._at[part] = now

    def stands_still(self, now: Monotonic) -> list[str]:
        """Return the parts that have not moved on for too long."""
        return [part for part, at in self._at.items() if now - at > self._max_still_s[part]]
