"""A configuration file with comments, as a plant has it."""

from __future__ import annotations

import stat
from dataclasses import dataclass
from pathlib import Path

TEXT = """\
# The plant.
[site]
name = "Mill 7"   # on every page

[server]
data = "data"

[[bus]]
name = "dry-end"
port = "/dev/null"

[[bus.unit]]
id = 1            # the address
name = "Unwind"   # as people call it

# Of the nip.
[[bus.unit]]
id = 2
name = "Nip"

[[notify.webhook]]
url = "https://hooks.plant.example/s3cret"
secret_file = "hook.key"
"""


def written(folder: Path) -> Path:
    """The file, readable by others."""
    path = folder / "lineside.toml"
    path.write_text(TEXT, encoding="utf-8")
    path.chmod(0o644)
    return path


@dataclass(frozen=True)
class PlantFile:
    """The file, as an editor has it."""

    path: Path

    @property
    def text(self) -> str:
        """As it is now."""
        return self.path.read_text(encoding="utf-8")

    def write(self, text: str) -> None:
        """Change it by hand."""
        self.path.write_text(text, encoding="utf-8")


def mode_of(path: Path) -> int:
    """The rights of a file."""
    return stat.S_IMODE(path.stat().st_mode)
