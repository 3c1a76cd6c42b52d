"""A finding of ``lineside check`` about this machine."""

from __future__ import annotations

import getpass
import os
from dataclasses import dataclass
from pathlib import Path

from bus.messages import Message, ParamValue


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the report. A fault keeps Lineside from working as configured; the rest informs."""

    message: Message
    is_fault: bool = False


def fault(code: str, /, **params: ParamValue) -> Finding:
    """A fault, by the code of its message."""
    return Finding(Message(code, params), is_fault=True)


def user() -> Message:
    """Who runs the check."""
    try:
        return Message.of("machine_user", user=getpass.getuser())
    except (KeyError, OSError):
        return Message.of("machine_user", user=os.getuid())


def is_visible(path: Path) -> bool:
    """Whether it exists in a folder that this user may look into."""
    try:
        return path.exists()
    except PermissionError:
        return False


def may_make_files_in(folder: Path) -> bool:
    """Whether it is a folder in which this user may make a file."""
    return is_visible(folder) and folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)
