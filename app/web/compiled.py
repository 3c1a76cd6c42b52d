"""Templates as Python reads them, kept in a folder from one start to the next."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from jinja2 import FileSystemBytecodeCache
from jinja2.bccache import Bucket


class Compiled(FileSystemBytecodeCache):
    """To compile what the first page needs takes a tenth of a second; one changed file is compiled again.

    A folder that cannot be written costs that time and nothing else.
    """

    def __init__(self, folder: Path) -> None:
        with suppress(OSError):
            folder.mkdir(0o700, parents=True, exist_ok=True)
        super().__init__(str(folder))

    def load_bytecode(self, bucket: Bucket) -> None:
        """Load the compiled form of one template, if it is stored."""
        with suppress(OSError):
            super().load_bytecode(bucket)

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Keep one template."""
        with suppress(OSError):
            super().dump_bytecode(bucket)
