"""A process that lives as long as a block of code."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def ended(process: subprocess.Popen[Any], within_s: float) -> Iterator[None]:
    """End ``process`` after the block: by SIGTERM; by SIGKILL where that takes longer than ``within_s``."""
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(within_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
