"""The systemd unit of the server, for ``lineside install-service``, the package and the documentation."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

USER = "lineside"
CONFIGURATION = Path("/etc/lineside/lineside.toml")
DATA = Path("/var/lib/lineside")
INSTALLED = Path("/opt/lineside/bin/lineside")
UNIT_FILE = Path("/etc/systemd/system/lineside.service")
WRONG_CONFIGURATION = os.EX_CONFIG
"""Exit code, as a service alone, of a configuration with which another start would end the same way."""
DRIVERS = ("usbserial", "cdc_acm")
"""Of serial adapters. A device that DeviceAllow names must have its driver when the service starts."""
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
SupplementaryGroups=dialout
StateDirectory=lineside
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
    the folders beside that of the configuration and the data which it may write in."""

    command: Path = INSTALLED
    configuration: Path = CONFIGURATION
    user: str = USER
    written: tuple[Path, ...] = ()

    @property
    def text(self) -> str:
        """The unit file."""
        return _TEMPLATE.format(
            drivers=" ".join(DRIVERS),
            command=self.command,
            configuration=self.configuration,
            user=self.user,
            # With a hyphen: a disk that is not mounted does not keep the service from its start.
            folders=" ".join([str(self.configuration.parent), *(f"-{folder}" for folder in self.written)]),
            wrong=WRONG_CONFIGURATION,
        )
