"""Ties a child process to its parent, so that it ends even when the parent is killed (Linux only)."""

from __future__ import annotations

import ctypes
import os
import signal
import sys

PARENT = "LINESIDE_PARENT"
"""The environment's name for the process that a child belongs to."""
_PR_SET_PDEATHSIG = 1


def tied_environment() -> dict[str, str]:
    """The environment for a child of this process."""
    return {**os.environ, PARENT: str(os.getpid())}


def named_parent() -> int | None:
    """Return the parent process id from the environment, and remove it there so that no child inherits it."""
    named = os.environ.pop(PARENT, "")
    return int(named) if named.isdecimal() else None


def tie_to(parent: int) -> None:
    """End this process by SIGTERM when ``parent`` ends; at once when it has ended. Called first of all."""
    if sys.platform != "linux":
        return
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if os.getppid() != parent:
        raise SystemExit(1)
