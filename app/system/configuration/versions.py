"""The versions of the configuration file, each in a file of the data folder for the server's user alone."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from pydantic import Field

from app.core.database.files import make_folder, write_file
from app.core.web.api.shape import InstantObject

FOLDER = "configuration"
"""In the data folder."""
MAX_VERSIONS = 100
"""The newest are kept."""
VersionOrigin = Literal["found", "by_hand", "changed", "rolled_back"]


@dataclass(frozen=True, slots=True)
class ConfigurationVersion:
    """A version without its text. ``origin``: the first one was ``found``; ``by_hand``: changed in the file
    itself, by then at the latest. ``who`` and ``reason``: empty for these two."""

    number: Annotated[int, Field(description="From 1.")]
    at: InstantObject
    origin: VersionOrigin
    digest: Annotated[str, Field(description="Identifies its text.")]
    who: str = ""
    reason: str = ""


@dataclass(frozen=True, slots=True)
class StoredVersion:
    """A version with its text, secrets included: never published."""

    version: ConfigurationVersion
    text: str


class VersionStore:
    """Raises OSError where one cannot be written."""

    def __init__(self, data: Path) -> None:
        self._folder = data / FOLDER

    def newest(self) -> StoredVersion | None:
        """The last one; None where there is none."""
        numbers = self._numbers()
        return self.one(numbers[0]) if numbers else None

    def every(self) -> list[StoredVersion]:
        """Those that are kept, newest first; without one that cannot be read."""
        found = (self.one(number) for number in self._numbers())
        return [each for each in found if each is not None]

    def one(self, number: int) -> StoredVersion | None:
        """A version; None where it is not kept, or cannot be read."""
        try:
            return msgspec.json.decode(self._file(number).read_bytes(), type=StoredVersion)
        except (OSError, msgspec.MsgspecError):
            return None

    @property
    def files(self) -> list[Path]:
        """Where they are, oldest first."""
        return [self._file(number) for number in reversed(self._numbers())]

    def next_number(self) -> int:
        """The number of the next version."""
        return max(self._numbers(), default=0) + 1

    def add(self, stored: StoredVersion) -> None:
        """Write one, on disk when this returns; the oldest beyond `MAX_VERSIONS` go."""
        make_folder(self._folder)
        write_file(self._file(stored.version.number), msgspec.json.encode(stored))
        for number in self._numbers()[MAX_VERSIONS:]:
            self._file(number).unlink(missing_ok=True)

    def withdraw(self, number: int) -> None:
        """Remove a version that did not become the file."""
        self._file(number).unlink(missing_ok=True)

    def _numbers(self) -> list[int]:
        names = [path.stem for path in self._folder.glob("*.json")] if self._folder.is_dir() else []
        return sorted((int(name) for name in names if name.isdecimal()), reverse=True)

    def _file(self, number: int) -> Path:
        return self._folder / f"{number:06d}.json"
