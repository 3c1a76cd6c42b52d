"""Something mounted, for tests of disks."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest


@contextmanager
def mounted(*mount: str, at: Path) -> Iterator[None]:
    """Something mounted; the test is left out where this user may not do that."""
    done = subprocess.run(["mount", *mount, str(at)], capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"only root may mount: {done.stderr.strip()}")
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", str(at)], check=True)
