"""``lineside init``: a configuration to start from."""

from __future__ import annotations

import json
from pathlib import Path

from app.cli.config_option import NEW_CONFIG, Config
from app.cli.ending import report
from app.errors import system_error
from bus.errors import LinesideError
from bus.messages import Message

BY_ID = Path("/dev/serial/by-id")
USUAL_PORT = "/dev/ttyUSB0"
STARTER = Path(__file__).with_name("starter.toml")


def init(config: Config = NEW_CONFIG) -> None:
    """Write a commented lineside.toml to start from. An existing file is never overwritten."""
    try:
        with config.open("x", encoding="utf-8") as file:
            file.write(starter(config, likely_port()))
    except FileExistsError as error:
        raise LinesideError(Message.of("configuration_exists", file=str(config))) from error
    except OSError as error:
        raise LinesideError(
            Message.of("configuration_not_writable", file=str(config), error=system_error(error))
        ) from error
    report(Message.of("configuration_written", file=str(config)))


def likely_port(folder: Path = BY_ID) -> str:
    """The first serial adapter of this machine by its lasting path; else a usual name."""
    adapters = sorted(str(entry) for entry in folder.iterdir()) if folder.is_dir() else []
    return adapters[0] if adapters else USUAL_PORT


def starter(config: Path, port: str) -> str:
    """The text of a new configuration. JSON's strings are TOML's too."""
    text = STARTER.read_text(encoding="utf-8")
    for name, value in {"config": str(config), "quoted_port": json.dumps(port), "port": port}.items():
        text = text.replace(f"{{{name}}}", value)
    return text
