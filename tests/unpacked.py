"""Programs of Debian's packages that ``make development`` unpacks: to install them would start them."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

UNPACKED = Path(__file__).resolve().parents[1] / ".venv" / "proxies"
FOLDERS = ("usr/sbin", "usr/bin")
LIBRARIES = {"LD_LIBRARY_PATH": "usr/lib/*-linux-gnu", "GENSIO_LIBRARY_PATH": "usr/libexec/*/gensio/*"}
"""Where the loader, and the streams of ser2net, look."""


def found(name: str) -> Path | None:
    """The path of a program; None where it was not unpacked and is not installed."""
    unpacked = (UNPACKED / folder / name for folder in FOLDERS)
    installed = shutil.which(name)
    return next((path for path in unpacked if path.exists()), Path(installed) if installed else None)


def program(name: str) -> str:
    """The path of a program; skips the test where there is none."""
    path = found(name)
    if path is None:
        pytest.skip(f"{name} is not here: make development unpacks it from Debian's packages")
    return str(path)


def beside(name: str, pattern: str) -> list[str]:
    """Paths that were unpacked together with a program, such as the libraries that it needs."""
    path = found(name)
    return [str(each) for each in path.parents[2].glob(pattern)] if path else []


def environment(name: str, **more: str) -> dict[str, str]:
    """The environment that a program needs to find what was unpacked beside it."""
    folders = {key: ":".join(beside(name, pattern)) for key, pattern in LIBRARIES.items()}
    return {"PATH": os.defpath, **folders, **more}
