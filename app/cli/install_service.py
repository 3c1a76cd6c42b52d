"""``lineside install-service``: the server as a service of systemd, with its user and its folders."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import click

from app.cli.installed_files import CONFIGURATION, DATA, UNIT_FILE, USER, ServiceUnit, first_configuration
from app.cli.options import PATH
from app.cli.process import report, wrong_option
from app.errors import system_error
from app.settings import ConfigurationError, Settings, load
from bus.errors import LinesideError
from bus.messages import Message

BOOTED = Path("/run/systemd/system")
"""There where systemd runs (sd_booted(3))."""
Runner = Callable[[Sequence[str]], None]


@click.command
@click.option(
    "--config", type=PATH, default=CONFIGURATION, help="The configuration; created where there is none."
)
@click.option("--user", default=USER, help="The user that runs it; created where there is none.")
@click.option("--dry-run", is_flag=True, help="Print the unit file and the steps, and change nothing.")
@click.option("--remove", is_flag=True, help="Stop and remove the service; configuration and data stay.")
@click.option("--json", "json_output", is_flag=True, help="Print the unit file and the steps as JSON.")
def install_service(config: Path, user: str, dry_run: bool, remove: bool, json_output: bool) -> None:
    """Install Lineside as a service of systemd, and start it; again, to bring it up to date."""
    if not re.fullmatch(r"[a-z_][a-z0-9_-]{0,30}", user):
        raise wrong_option("--user", "user_not_of_unix", value=user)
    unit = unit_of(
        Path(sys.argv[0]).absolute(), config.absolute(), user, None if remove else configured(config)
    )
    commands = list(removal(UNIT_FILE) if remove else installation(unit, user_exists(user)))
    if dry_run or json_output:
        _print(unit, commands, as_json=json_output)
    if dry_run:
        return
    refuse_without_systemd()
    if not remove:
        refuse_elsewhere(unit.command)
    carry_out(unit, commands, run, unit_file=None if remove else UNIT_FILE)
    if not json_output:
        report(Message.of("service_removed" if remove else "service_installed", file=str(config)))


def configured(config: Path) -> Settings | None:
    """Return the configuration, or None if it is yet to be written. Raises ConfigurationError: a service with
    a wrong one would not start."""
    try:
        return load(config)
    except ConfigurationError as error:
        if [fault.code for fault in error.faults] == ["configuration_missing"]:
            return None
        raise


def unit_of(command: Path, config: Path, user: str, settings: Settings | None) -> ServiceUnit:
    """Return the service of a configuration. It may open serial ports, unless every bus is on a device
    server."""
    if settings is None:
        return ServiceUnit(command, config, user)
    has_ports = not settings.bus or any(bus.has_local_port for bus in settings.bus)
    return ServiceUnit(command, config, user, _folders_written(settings, config), has_ports)


def _folders_written(settings: Settings, config: Path) -> tuple[Path, ...]:
    """Return the folders, beside its own, in which a service of this configuration writes: backups, the
    archive of events, the anchor of the audit log and its key, and the data if they are elsewhere."""
    key, anchor = settings.audit.key_file, settings.audit.anchor
    archives = (settings.backup.folder, settings.audit.archive)
    named = (settings.server.data, *archives, anchor and anchor.parent, key and key.parent)
    own = (DATA, config.parent)
    written = (folder for folder in named if folder and not any(map(folder.is_relative_to, own)))
    return tuple(dict.fromkeys(written))


def installation(unit: ServiceUnit, user_is_there: bool) -> Iterator[list[str]]:
    """Return the commands that install a service, in order. Configuration and unit file are written after
    those that make the folders."""
    if not user_is_there:
        shell = ("--shell", "/usr/sbin/nologin")
        yield ["useradd", "--system", "--home-dir", str(DATA), *shell, unit.user]
    owned = ("-o", unit.user, "-g", unit.user)
    yield ["install", "-d", *owned, "-m", "0750", str(unit.configuration.parent)]
    yield ["install", "-d", *owned, "-m", "0700", str(DATA)]
    yield ["systemctl", "daemon-reload"]
    yield ["systemctl", "enable", UNIT_FILE.name]
    yield ["systemctl", "restart", UNIT_FILE.name]


def removal(unit_file: Path) -> Iterator[list[str]]:
    """Return the commands that remove a service."""
    yield ["systemctl", "disable", "--now", unit_file.name]
    yield ["rm", "-f", str(unit_file)]
    yield ["systemctl", "daemon-reload"]


def carry_out(
    unit: ServiceUnit, commands: Sequence[Sequence[str]], run: Runner, *, unit_file: Path | None
) -> None:
    """Run the commands, and write the unit file, if any, before systemd reads it."""
    for command in commands:
        if unit_file is not None and command[:2] == ["systemctl", "daemon-reload"]:
            write_configuration(unit)
            _keep_edited(unit_file, unit.text)
            unit_file.write_text(unit.text, encoding="utf-8")
            unit_file.chmod(0o644)
        run(command)


def _keep_edited(unit_file: Path, text: str) -> None:
    """Keep a unit file with another text, which a person may have edited, under another name."""
    if unit_file.exists() and unit_file.read_bytes() != text.encode():
        kept = unit_file.with_name(f"{unit_file.name}.before")
        unit_file.replace(kept)
        report(Message.of("service_edited_kept", file=str(kept)))


def write_configuration(unit: ServiceUnit) -> None:
    """Write a first configuration with the folder of the data, unless there is one."""
    try:
        with unit.configuration.open("x", encoding="utf-8") as file:
            file.write(first_configuration(unit.configuration))
    except FileExistsError:
        return
    unit.configuration.chmod(0o640)
    shutil.chown(unit.configuration, unit.user, unit.user)


def user_exists(name: str) -> bool:
    # Not imported with the commands that need no user.
    import pwd

    try:
        pwd.getpwnam(name)
    except KeyError:
        return False
    return True


def refuse_without_systemd() -> None:
    """Raise LinesideError if there is no systemd, or the caller may not change it."""
    if not BOOTED.is_dir():
        raise LinesideError(Message("service_without_systemd"))
    if os.geteuid() != 0:
        raise LinesideError(Message.of("service_needs_root", command=shlex.join(sys.argv)))


def refuse_elsewhere(command: Path) -> None:
    """Raise LinesideError for a program in a home folder, which the service cannot read (ProtectHome)."""
    if command.is_relative_to("/home") or command.is_relative_to("/root"):
        raise LinesideError(Message.of("service_in_home", path=str(command)))


def run(command: Sequence[str]) -> None:
    """Run a command. Raises LinesideError with what it printed."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        raise _failed(command, system_error(error)) from error
    if done.returncode:
        raise _failed(command, done.stderr.strip() or f"exit code {done.returncode}")


def _failed(command: Sequence[str], reason: Message | str) -> LinesideError:
    return LinesideError(Message.of("service_step_failed", command=shlex.join(command), reason=reason))


def _print(unit: ServiceUnit, commands: Sequence[Sequence[str]], *, as_json: bool) -> None:
    if as_json:
        steps = [shlex.join(command) for command in commands]
        click.echo(json.dumps({"unit_file": str(UNIT_FILE), "unit": unit.text, "steps": steps}, indent=2))
        return
    click.echo(f"# {UNIT_FILE}\n{unit.text}")
    for command in commands:
        click.echo(f"# {shlex.join(command)}")
