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
    Option(help=f"The configuration; without it {CONFIG_VARIABLE}, lineside.toml here, or {CONFIGURATION}."),
]


def default_config(environment: Mapping[str, str] = os.environ, of_service: Path = CONFIGURATION) -> Path:
    """The configuration of a command that names none: the named one of the environment, the one in this
    folder, that of the service; without any of them the name of a new one."""
    if named := environment.get(CONFIG_VARIABLE):
        return Path(named)
    return of_service if not NEW_CONFIG.exists() and of_service.exists() else NEW_CONFIG


LINESIDE_TOML = default_config()
