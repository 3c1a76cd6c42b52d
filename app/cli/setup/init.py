"""``lineside init``: a configuration to start from, which a terminal prompts for."""

from __future__ import annotations

import asyncio
import json
import sys
from pathlib import Path

import click

from app.cli.config_option import NEW_CONFIG, Config
from app.cli.ending import report
from app.cli.setup.rights import become_owner_of
from app.errors import system_error
from bus.errors import CallerError, LinesideError
from bus.messages import Message

BY_ID = Path("/dev/serial/by-id")
USUAL_PORT = "/dev/ttyUSB0"
STARTER = Path(__file__).with_name("starter.toml")
BUS = "# One [[bus]] for each RS-422 cable.\n"
"""Of the starter: what follows is the bus."""
ADDRESSES = range(1, 256)
ALLOWED_S = 0.05


def init(config: Config = NEW_CONFIG) -> None:
    """Write a commented lineside.toml to start from. An existing file is never overwritten.

    At a terminal it prompts for the name of the machine, the port, whether to scan it, and the first admin.
    """
    become_owner_of(config.resolve().parent)
    if config.exists():
        raise _exists(config)
    prompts = is_interactive()
    text = prompted_text(config) if prompts else starter(config, likely_port())
    try:
        with config.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError as error:
        raise _exists(config) from error
    except OSError as error:
        raise LinesideError(
            Message.of("configuration_not_writable", file=str(config), error=system_error(error))
        ) from error
    if prompts:
        prompt_for_admin(config)
    report(Message.of("configuration_written", file=str(config)))


def is_interactive() -> bool:
    """Whether there is a person at a terminal."""
    return sys.stdin.isatty() and sys.stdout.isatty()


def _exists(config: Path) -> LinesideError:
    return LinesideError(Message.of("configuration_exists", file=str(config)))


def prompted_text(config: Path) -> str:
    """A new configuration of what a person types, and of what a scan finds."""
    name = click.prompt("Name of the machine", default="My line")
    for adapter in adapters():
        click.echo(f"  adapter: {adapter}")
    port = click.prompt("Port", default=likely_port())
    text = starter(config, port).replace('name = "My line"', f"name = {json.dumps(name)}", 1)
    if not click.confirm("Scan it for units now? Nothing is written to them.", default=True):
        return text
    table = _scanned(port)
    return text.partition(BUS)[0] + BUS + table if table else text


def _scanned(port: str) -> str:
    """The bus with the units that respond; empty where there is none, or no port, which it prints."""
    # The scanner is the bus worker's: a file without a scan does not need it.
    from app.cli.wire.bus_table import bus_table
    from app.cli.wire.scan import allowed_ms, bauds_to_try, scan_bauds, units_of
    from bus.line.scan.scanner import BaudScan

    scans: list[BaudScan] = []
    try:
        asyncio.run(scan_bauds(scans, port, bauds_to_try(port, None), ADDRESSES, ALLOWED_S, False))
    except LinesideError as error:
        report(error.message, err=True)
    found = units_of(scans)
    if not found:
        report(Message("init_found_no_unit"), err=True)
        return ""
    report(Message.of("init_found_units", n=len(found)))
    return bus_table(port, found, allowed_ms(scans))


def prompt_for_admin(config: Path) -> None:
    """The first user, who can add the others; without a name the dashboard prompts for one."""
    from app.cli.setup.accounts import prompted_password, store_user
    from app.web.admission.access import Role

    while name := click.prompt("First admin (empty: later, in the browser)", default="", show_default=False):
        try:
            store_user(config, name, Role.ADMIN, prompted_password())
        except CallerError as error:  # such as a password that is too simple
            report(error.message, err=True)
        else:
            break


def adapters(folder: Path = BY_ID) -> list[str]:
    """The serial adapters of this machine by their lasting paths."""
    return sorted(str(entry) for entry in folder.iterdir()) if folder.is_dir() else []


def likely_port(folder: Path = BY_ID) -> str:
    """The first serial adapter; else a usual name."""
    return next(iter(adapters(folder)), USUAL_PORT)


def starter(config: Path, port: str) -> str:
    """The text of a new configuration. JSON's strings are TOML's too."""
    text = STARTER.read_text(encoding="utf-8")
    for name, value in {"config": str(config), "quoted_port": json.dumps(port), "port": port}.items():
        text = text.replace(f"{{{name}}}", value)
    return text
