"""The options that several commands have, and where the configuration is when a command names none."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import click

CONFIG_VARIABLE = "LINESIDE_CONFIG"
INSTALLED_CONFIG = Path("/etc/lineside/lineside.toml")
"""The configuration of the installed service."""
NEW_CONFIG = Path("lineside.toml")
TOKEN_VARIABLE = "LINESIDE_TOKEN"
PATH = click.Path(path_type=Path)
ADDRESS = click.IntRange(1, 255)
TCP_PORT = click.IntRange(0, 65535)


def default_config(environment: Mapping[str, str] = os.environ, of_service: Path = INSTALLED_CONFIG) -> Path:
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
config_option = click.option(
    "--config",
    type=PATH,
    default=LINESIDE_TOML,
    help=f"The configuration; without it {CONFIG_VARIABLE}, {INSTALLED_CONFIG}, or lineside.toml here.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="The result as JSON.")
yes_option = click.option("--yes", is_flag=True, help="Skip the confirmation.")
url_option = click.option("--url", required=True, envvar="LINESIDE_URL", help="Address of the dashboard.")
bus_option = click.option("--bus", required=True, help="Name of the bus.")
token_option = click.option(
    "--token",
    default="",
    show_default=False,
    help=f"A bearer token. Other users of this machine can see it: use --token-file or {TOKEN_VARIABLE}.",
)
token_file_option = click.option(
    "--token-file", type=PATH, help="A file whose first line is the bearer token."
)
