"""``--config`` of every command, and where the configuration is when it is not given."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from app.cli.options import Option
from app.cli.setup.service_unit import CONFIGURATION

CONFIG_VARIABLE = "LINESIDE_CONFIG"
NEW_CONFIG = Path("lineside.toml")
Config = Annotated[
    Path,
    Option(help=f"The configuration; without it {CONFIG_VARIABLE}, {CONFIGURATION}, or lineside.toml here."),
]


def default_config(environment: Mapping[str, str] = os.environ, of_service: Path = CONFIGURATION) -> Path:
    """Return the configuration of a command that names none: the one that the environment names, that of an
    installed service, else ``lineside.toml`` in this folder, which may be yet to be written."""
    if named := environment.get(CONFIG_VARIABLE):
        return Path(named)
    return of_service if is_installed(of_service) else NEW_CONFIG


def is_installed(of_service: Path) -> bool:
    """Whether a service has its configuration there, as far as this user may look: the folder is closed to
    others, who are then told so, instead of being given another file."""
    folder = of_service.parent
    return os.path.exists(of_service) or (folder.is_dir() and not os.access(folder, os.X_OK))  # noqa: PTH110


LINESIDE_TOML = default_config()
