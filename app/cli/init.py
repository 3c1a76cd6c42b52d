"""The command ``lineside init``: a first configuration, for which it prompts at a terminal."""

from __future__ import annotations

import asyncio
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from os import geteuid
from pathlib import Path

import click

from app.cli import install_service
from app.cli.command import acting_as_owner_of, config_option, report
from app.cli.install_service import (
    CONFIGURATION,
    PACKAGED_UNIT,
    UNIT_FILE,
    example_bus,
    has_own_bus,
    likely_port,
    with_bus,
    with_names,
    without_bus,
)
from app.errors import system_error
from app.settings import parse
from app.system.configuration.port_scan import adapters
from app.system.configuration.service import replace_file
from bus.configuration import ConfigurationError, read
from bus.errors import CallerError, LinesideError
from bus.messages import Message

ADDRESSES = range(1, 256)
ALLOWED_S = 0.05


@click.command
@config_option
def init(config: Path) -> None:
    """Write a commented lineside.toml to start from, or complete that of the installed service. A file with a
    bus of its own is never changed.

    At a terminal it prompts for the name of the machine, the port, whether to scan it, the names of the
    units, and the first admin. The installed service is stopped for the scan and starts with the new file.
    """
    present = _present_text(config)
    text = without_bus(config) if present is None else present
    prompts = is_interactive()
    with _service_stopped(config) if prompts else nullcontext():
        example = example_bus(config, likely_port())
        text = _prompted_text(config, text) if prompts else with_bus(text, example)
        with acting_as_owner_of(config.resolve().parent):
            write(config, present, text)
            if prompts:
                _prompt_for_admin(config)
    report(Message.of("configuration_written", file=str(config)))


def is_interactive() -> bool:
    """Return whether a person is at a terminal."""
    return sys.stdin.isatty() and sys.stdout.isatty()


def _present_text(config: Path) -> str | None:
    """Return the text of a file that has no bus yet, or None if there is no file. Raise LinesideError for any
    other file, which is kept."""
    try:
        text = read(config)
    except ConfigurationError as error:
        if [fault.code for fault in error.faults] == ["configuration_missing"]:
            return None
        raise
    if has_own_bus(text):
        raise _exists(config)
    return text


def write(config: Path, present: str | None, text: str) -> None:
    """Write a new file, or replace one that has not changed since it was read. Raise LinesideError."""
    try:
        if present is not None:
            replace_file(config, present, text)
            return
        with config.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError as error:
        raise _exists(config) from error
    except OSError as error:
        raise LinesideError(
            Message.of("configuration_not_writable", file=str(config), error=system_error(error))
        ) from error


def _exists(config: Path) -> LinesideError:
    return LinesideError(Message.of("configuration_exists", file=str(config)))


@contextmanager
def _service_stopped(config: Path) -> Iterator[None]:
    """Stop the installed service of this configuration, which may have the port open, and start it again in
    any case. Raise LinesideError unless root calls."""
    is_installed = UNIT_FILE.exists() or PACKAGED_UNIT.exists()
    if not (is_installed and config.absolute() == CONFIGURATION and install_service.BOOTED.is_dir()):
        yield
        return
    if geteuid() != 0:
        raise LinesideError(Message.of("init_needs_root", file=str(config)))
    install_service.run(["systemctl", "stop", UNIT_FILE.name])
    try:
        yield
    finally:
        install_service.run(["systemctl", "restart", UNIT_FILE.name])
        report(Message.of("init_service_started", unit=UNIT_FILE.stem))


def _prompted_text(config: Path, text: str) -> str:
    """Return the configuration with the texts that a person types and the result of a scan. Raise
    ConfigurationError for a wrong value, such as too long a name."""
    site = click.prompt("Name of the machine", default="My line")
    for adapter in adapters():
        click.echo(f"  adapter: {adapter}")
    port = click.prompt("Port", default=likely_port())
    table, names = "", {}
    if click.confirm("Scan it for units now? Nothing is written to them.", default=True):
        table = _scanned(port)
        units = tomllib.loads(table)["bus"][0]["unit"] if table else []
        names = {
            unit["id"]: click.prompt(f"Name of unit {unit['id']}", default=unit["name"]) for unit in units
        }
    text = with_names(with_bus(text, table or example_bus(config, port)), site, names)
    parse(text, config)
    return text


def _scanned(port: str) -> str:
    """Scan a port; return the bus with the units that respond; if none does, report that and return an empty
    text."""
    # The bus worker owns the scanner: a file without a scan does not need it.
    from app.cli.wire import allowed_ms, bauds_to_try, bus_table, scan_bauds, units_of
    from bus.line.scanner import BaudScan

    scans: list[BaudScan] = []
    try:
        asyncio.run(scan_bauds(scans, port, bauds_to_try(port, None), ADDRESSES, ALLOWED_S, False))
    except LinesideError as error:
        report(error.message, err=True)
    found = [one for one in units_of(scans) if one.kind == "digimax"]
    if not found:
        report(Message("init_found_no_unit"), err=True)
        return ""
    report(Message.of("init_found_units", n=len(found)))
    return bus_table(port, units_of(scans), allowed_ms(scans))


def _prompt_for_admin(config: Path) -> None:
    """Prompt for the first user, who can add others; without a name, the browser prompts for one."""
    from app.cli.accounts import prompted_password, store_user
    from app.core.web.access import Role

    while name := click.prompt("First admin (empty: later, in the browser)", default="", show_default=False):
        try:
            store_user(config, name, Role.ADMIN, prompted_password())
        except CallerError as error:  # such as a password that is too simple
            report(error.message, err=True)
        else:
            break
