"""``lineside check --live`` on configurations of tests."""

from __future__ import annotations

import os
import pty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from click.testing import CliRunner, Result

from app.cli import check


@contextmanager
def pseudo_terminal() -> Iterator[tuple[int, str]]:
    """The other end of a serial port, and its path."""
    master, slave = pty.openpty()
    path = os.ttyname(slave)
    os.close(slave)
    try:
        yield master, path
    finally:
        os.close(master)


def bus(port: str) -> str:
    """A bus with one unit."""
    return f'[[bus]]\nname = "dry-end"\nport = "{port}"\n[[bus.unit]]\nid = 1\nname = "Unwind"\n'


def run(config: Path, text: str, *words: str) -> Result:
    """Write the configuration, and check it."""
    config.write_text(text, encoding="utf-8")
    return check_live(config, *words)


def check_live(config: Path, *words: str) -> Result:
    """Check a configuration as it is."""
    return CliRunner().invoke(check.check, ["--live", "--config", str(config), *words])


def everything_in(folder: Path) -> dict[Path, tuple[int, int]]:
    """When each file was changed, and its size."""
    return {path: (path.stat().st_mtime_ns, path.stat().st_size) for path in (folder, *folder.rglob("*"))}
