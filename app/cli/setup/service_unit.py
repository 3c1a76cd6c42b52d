"""The systemd unit of the server, for ``lineside install-service``, the package and the documentation."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

from app.cli.options import INSTALLED_CONFIG
from bus.errors import LinesideError
from bus.messages import Message

USER = "lineside"
CONFIGURATION = INSTALLED_CONFIG
DATA = Path("/var/lib/lineside")
INSTALLED = Path("/opt/lineside/bin/lineside")
UNIT_FILE = Path("/etc/systemd/system/lineside.service")
PACKAGED_UNIT = Path("/usr/lib/systemd/system/lineside.service")
"""Of the Debian package; one in ``/etc`` goes before it."""
WRONG_CONFIGURATION = os.EX_CONFIG
"""Exit code, as a service alone, of a configuration with which another start would end the same way."""
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


@dataclass(frozen=True, slots=True)
class ServiceUnit:
    """``command``: the program ``lineside``; ``configuration``: its file; ``user``: who runs it; ``written``:
    the folders beside that of the configuration and the data which it may write in; ``has_ports``: whether a
    bus is on a serial port of this machine."""

    command: Path = INSTALLED
    configuration: Path = CONFIGURATION
    user: str = USER
    written: tuple[Path, ...] = ()
    has_ports: bool = True

    @property
    def text(self) -> str:
        """The unit file. Raises LinesideError for a path that cannot be in it."""
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
    """A word of a unit file as systemd writes it: a percent sign begins a specifier, and a space ends a word.
    Raises LinesideError for one with a line break or the like, which a unit file cannot hold."""
    if not word.isprintable():
        raise LinesideError(Message.of("service_path_unprintable", path=repr(word)))
    if _PLAIN.fullmatch(word):
        return word
    escaped = word.replace("%", "%%").replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
