"""The command ``lineside install-service``: the server as a systemd service, with its user, folders and
files, including a first lineside.toml. The package and the documentation use the same files."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from app.cli.command import INSTALLED_CONFIG, PATH, WRONG_CONFIGURATION, report, wrong_option
from app.errors import system_error
from app.settings import ConfigurationError, Settings, load
from app.system.configuration.document import content_of, with_values, without
from app.system.configuration.port_scan import BY_ID, adapters
from bus.configuration import toml_of
from bus.errors import LinesideError
from bus.messages import Message

USER = "lineside"
CONFIGURATION = INSTALLED_CONFIG
DATA = Path("/var/lib/lineside")
INSTALLED = Path("/opt/lineside/bin/lineside")
UNIT_FILE = Path("/etc/systemd/system/lineside.service")
PACKAGED_UNIT = Path("/usr/lib/systemd/system/lineside.service")
"""The unit file of the Debian package; a file in ``/etc`` precedes it."""
DRIVERS = ("usbserial", "cdc_acm")
"""The drivers of serial adapters, needed before the start for a device that DeviceAllow names."""
_PORTS = "SupplementaryGroups=dialout\n"
_PLAIN = re.compile(r"[\w@:./+=,-]+", re.ASCII)
"""A word that systemd reads as written (systemd.syntax(7))."""
_TEMPLATE = """\
[Unit]
Description=Lineside dashboard and bus workers
Wants=network-online.target
After=network-online.target
StartLimitIntervalSec=0

[Service]
Type=notify
NotifyAccess=main
WatchdogSec=20
TimeoutStartSec=15min
ExecStartPre=+-/sbin/modprobe -a {drivers}
ExecStart={command} serve --config {configuration}
User={user}
Group={user}
{groups}StateDirectory=lineside
StateDirectoryMode=0700
ReadWritePaths={folders}
UMask=0077
Restart=always
RestartSec=2
RestartPreventExitStatus={wrong}
KillMode=mixed
KillSignal=SIGTERM
TimeoutStopSec=15
LimitNICE=-10
NoNewPrivileges=yes
CapabilityBoundingSet=
DevicePolicy=closed
DeviceAllow=char-tty[A-Z]* rw
ProtectSystem=strict
ProtectHome=yes
ProtectHostname=yes
ProtectClock=yes
ProtectKernelLogs=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
ProtectControlGroups=yes
ProtectProc=invisible
PrivateTmp=yes
RemoveIPC=yes
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6
RestrictNamespaces=yes
RestrictRealtime=yes
RestrictSUIDSGID=yes
LockPersonality=yes
MemoryDenyWriteExecute=yes
SystemCallArchitectures=native
SystemCallFilter=@system-service
SystemCallErrorNumber=EPERM

[Install]
WantedBy=multi-user.target
"""


USUAL_PORT = "/dev/ttyUSB0"
STARTER = Path(__file__).with_name("starter.toml")
BUS = "# One [[bus]] for each RS-422 cable.\n"
"""The line of the starter after which the bus follows."""
NO_BUS = f"{BUS}# Not set yet: sudo lineside init, or the page Configuration.\n"


@dataclass(frozen=True, slots=True)
class ServiceUnit:
    """The unit of the server. ``command``: the program ``lineside``; ``written``: folders in which it may
    write besides those of the configuration and the data; ``has_ports``: whether a bus is on a serial port of
    this machine."""

    command: Path = INSTALLED
    configuration: Path = CONFIGURATION
    user: str = USER
    written: tuple[Path, ...] = ()
    has_ports: bool = True

    @property
    def text(self) -> str:
        """The text of the unit file. Raises LinesideError for a path that it cannot contain."""
        # The hyphen lets the service start even if a disk is not mounted.
        written = (f"-{folder}" for folder in self.written)
        return _TEMPLATE.format(
            drivers=" ".join(DRIVERS),
            command=quoted(str(self.command)),
            # A dollar begins a variable in arguments, but not in the program (systemd.service(5)).
            configuration=quoted(str(self.configuration).replace("$", "$$")),
            user=self.user,
            groups=_PORTS if self.has_ports else "",
            folders=" ".join(map(quoted, (str(self.configuration.parent), *written))),
            wrong=WRONG_CONFIGURATION,
        )


def quoted(word: str) -> str:
    """Return a word as systemd reads it in a unit file, where a percent sign begins a specifier and a space
    ends a word. Raise LinesideError for a word with a line break or the like, which unit files do not
    allow."""
    if not word.isprintable():
        raise LinesideError(Message.of("service_path_unprintable", path=repr(word)))
    if _PLAIN.fullmatch(word):
        return word
    escaped = word.replace("%", "%%").replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def likely_port(folder: Path = BY_ID) -> str:
    """Return the first serial adapter, or a usual name if there is none."""
    return next(iter(adapters(folder)), USUAL_PORT)


def starter(config: Path, port: str) -> str:
    """Return the text of a new configuration. Strings of JSON are strings of TOML."""
    text = STARTER.read_text(encoding="utf-8")
    for name, value in {"config": str(config), "quoted_port": toml_of(port), "port": port}.items():
        text = text.replace(f"{{{name}}}", value)
    return text


def first_configuration(path: Path) -> str:
    """Return the first configuration of a service at ``path``: it serves, and has no bus yet."""
    # The data is below the folder that the service may write: the audit log's anchor is beside it.
    text = without_bus(path)
    return re.sub(r'^data = ".*"', f"data = {toml_of(str(DATA / 'data'))}", text, flags=re.M)


def without_bus(config: Path) -> str:
    """Return the starter without its example of a bus."""
    return starter(config, USUAL_PORT).partition(BUS)[0] + NO_BUS


def example_bus(config: Path, port: str) -> str:
    """Return the starter's example of a bus, with comments."""
    return starter(config, port).partition(BUS)[2]


def has_own_bus(text: str) -> bool:
    """Return whether a text has a bus that a person set up, or is no TOML: such a file is kept as it is. The
    example of the starter does not count, whatever its port."""
    data = content_of(text)
    return data is None or bool(_buses(data) and _shape(data) != _shape(tomllib.loads(starter(Path(), ""))))


def with_bus(text: str, table: str) -> str:
    """Add ``table``, replacing the starter's example, if it is there."""
    if _buses(tomllib.loads(text)):
        text = without(text, ("bus", 0))
    return f"{text.rstrip()}\n\n{table}"


def with_names(text: str, site: str, names: dict[int, str]) -> str:
    """Set the name of the site, and the names of the units of the only bus, by address."""
    text = with_values(text, ("site",), {"name": site})
    for index, unit in enumerate(tomllib.loads(text)["bus"][0]["unit"]):
        if unit["id"] in names:
            text = with_values(text, ("bus", 0, "unit", index), {"name": names[unit["id"]]})
    return text


def _buses(data: Any) -> Any:
    return data.get("bus", [])


def _shape(data: Any) -> Any:
    buses = _buses(data)
    return [{**bus, "port": ""} for bus in buses] if all(isinstance(bus, dict) for bus in buses) else buses


BOOTED = Path("/run/systemd/system")
"""The folder that exists where systemd runs (sd_booted(3))."""
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
    """Install Lineside as a service of systemd and start it; repeat this to bring it up to date."""
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
    """Return the configuration, or None if it does not exist yet. Raise ConfigurationError: a service with a
    wrong configuration would not start."""
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
    """Return the folders, besides its own, in which a service of this configuration writes: backups, the
    archive of events, the anchor of the audit log and its key, and the data if they are elsewhere."""
    key, anchor = settings.audit.key_file, settings.audit.anchor
    archives = (settings.backup.folder, settings.audit.archive)
    named = (settings.server.data, *archives, anchor and anchor.parent, key and key.parent)
    own = (DATA, config.parent)
    written = (folder for folder in named if folder and not any(map(folder.is_relative_to, own)))
    return tuple(dict.fromkeys(written))


def installation(unit: ServiceUnit, user_is_there: bool) -> Iterator[list[str]]:
    """Return the commands that install a service, in order. Configuration and unit file are written after the
    folders exist."""
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
    """Write a first configuration with the folder of the data, unless one exists."""
    try:
        with unit.configuration.open("x", encoding="utf-8") as file:
            file.write(first_configuration(unit.configuration))
    except FileExistsError:
        return
    unit.configuration.chmod(0o640)
    shutil.chown(unit.configuration, unit.user, unit.user)


def user_exists(name: str) -> bool:
    # Imported only here: other commands need no user.
    import pwd

    try:
        pwd.getpwnam(name)
    except KeyError:
        return False
    return True


def refuse_without_systemd() -> None:
    """Raise LinesideError if systemd is missing, or the caller may not change it."""
    if not BOOTED.is_dir():
        raise LinesideError(Message("service_without_systemd"))
    if os.geteuid() != 0:
        raise LinesideError(Message.of("service_needs_root", command=shlex.join(sys.argv)))


def refuse_elsewhere(command: Path) -> None:
    """Raise LinesideError for a program in a home folder, which services cannot read (ProtectHome)."""
    if command.is_relative_to("/home") or command.is_relative_to("/root"):
        raise LinesideError(Message.of("service_in_home", path=str(command)))


def run(command: Sequence[str]) -> None:
    """Run a command. Raise LinesideError with its output."""
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
