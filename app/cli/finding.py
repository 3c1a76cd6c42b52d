"""A finding of ``lineside check`` about this machine."""

from __future__ import annotations

import getpass
import os
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from app.database.private import FOLDER_MODE
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
    except OSError:
        return False


def may_make_files_in(folder: Path) -> bool:
    """Whether it is a folder in which this user can make a file. It is tried: root may write to ``/proc`` and
    still cannot. The file is gone at once."""
    if not os.access(folder, os.W_OK | os.X_OK):
        return False
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"x")
    except OSError:
        return False
    return True


def can_make_folder(folder: Path) -> bool:
    """Whether it and its parents can be made where they are not there; they are removed at once."""
    absent = [each for each in (folder, *folder.parents) if not is_visible(each)]
    if absent and not may_make_files_in(absent[-1].parent):
        return False
    made: list[Path] = []
    try:
        for each in reversed(absent):
            each.mkdir(FOLDER_MODE)
            made.append(each)
        return may_make_files_in(folder)
    except OSError:
        return False
    finally:
        for each in reversed(made):
            with suppress(OSError):
                each.rmdir()
