"""The files of an installation: the unit of systemd, for ``lineside install-service``, the package and the
documentation, and a first lineside.toml.
"""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from app.cli.options import INSTALLED_CONFIG
from app.cli.process import WRONG_CONFIGURATION
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
"""Of the Debian package; one in ``/etc`` goes before it."""
DRIVERS = ("usbserial", "cdc_acm")
"""Of serial adapters. A device that DeviceAllow names must have its driver when the service starts."""
_PORTS = "SupplementaryGroups=dialout\n"
_PLAIN = re.compile(r"[\w@:./+=,-]+", re.ASCII)
"""A word that systemd takes as it is written (systemd.syntax(7))."""
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
"""Of the starter: what follows is the bus."""
NO_BUS = f"{BUS}# Not set yet: sudo lineside init, or the page Configuration.\n"


@dataclass(frozen=True, slots=True)
class ServiceUnit:
    """The unit of the server. ``command``: the program ``lineside``; ``written``: folders, beside those of
    the configuration and the data, that it may write in; ``has_ports``: whether a bus is on a serial port of
    this machine."""

    command: Path = INSTALLED
    configuration: Path = CONFIGURATION
    user: str = USER
    written: tuple[Path, ...] = ()
    has_ports: bool = True

    @property
    def text(self) -> str:
        """Return the unit file. Raises LinesideError for a path that cannot be in it."""
        # With a hyphen: a disk that is not mounted does not keep the service from its start.
        written = (f"-{folder}" for folder in self.written)
        return _TEMPLATE.format(
            drivers=" ".join(DRIVERS),
            command=quoted(str(self.command)),
            # A dollar begins a variable in arguments, and not in the program (systemd.service(5)).
            configuration=quoted(str(self.configuration).replace("$", "$$")),
            user=self.user,
            groups=_PORTS if self.has_ports else "",
            folders=" ".join(map(quoted, (str(self.configuration.parent), *written))),
            wrong=WRONG_CONFIGURATION,
        )


def quoted(word: str) -> str:
    """Return a word as systemd reads it in a unit file, where a percent sign begins a specifier and a space
    ends a word. Raises LinesideError for a word with a line break or the like, which a unit file cannot
    hold."""
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
    """Return the configuration that a service begins with at ``path``: it serves, and has no bus yet."""
    # Below the folder that the service may write in: the anchor of the audit log is beside the data.
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
    example of the starter does not count, at whatever port."""
    data = content_of(text)
    return data is None or bool(_buses(data) and _shape(data) != _shape(tomllib.loads(starter(Path(), ""))))


def with_bus(text: str, table: str) -> str:
    """Add ``table`` in place of the starter's example, if there is one."""
    if _buses(tomllib.loads(text)):
        text = without(text, ("bus", 0))
    return f"{text.rstrip()}\n\n{table}"


def with_names(text: str, site: str, names: dict[int, str]) -> str:
    """Set the name of the site and, by address, those of the units of the only bus."""
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
