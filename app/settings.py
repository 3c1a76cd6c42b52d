"""The complete lineside.toml: the site, the server and every bus."""

from __future__ import annotations

import os
import re
from hashlib import sha256
from ipaddress import IPv4Network, IPv6Network, ip_address, ip_network
from pathlib import Path
from typing import Annotated

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PrivateAttr,
    StrictBool,
    field_validator,
    model_validator,
)

from app.core.former_settings import former_notices, without_former_keys
from app.core.messages.languages import catalogs, is_zone, machine_zone
from app.core.server.settings import TlsSettings, is_loopback
from app.line.alarms.settings import AlarmSettings, BuiltInAlarmSettings, refuse_built_in, refuse_misplaced
from app.line.history.settings import HistorySettings
from app.people.audit.settings import Audit
from app.people.auth.settings import OidcSettings, Sessions
from app.records.handover.rules import ShiftSettings
from app.records.notification.settings import NotifySettings, refuse_unknown_names
from app.records.reports.rules import ReportSettings, refuse_unsendable
from app.system.backup.settings import BackupSettings
from app.system.mqtt.settings import MqttSettings
from app.system.opcua.settings import OpcuaSettings
from app.system.peers.settings import PeerSettings, refuse_repeated
from app.system.postgresql.settings import PostgresqlSettings
from app.version import VERSION
from bus import configuration
from bus.configuration import ConfigurationError
from bus.messages import Message
from bus.settings import BusSettings, StrictModel
from bus.validation import OneLine, setting_fault

__all__ = ["ConfigurationError", "ServerSettings", "Settings", "Site", "load", "parse"]

_HOST_NAME = re.compile(r"(?!-)[A-Za-z0-9_-]{1,63}(?:\.[A-Za-z0-9_-]{1,63})*")


STORE_FILE = "lineside.db"
"""The main store, in the data folder."""
LOCK_FILE = "lock"
"""The lock file in the data folder, which a server has locked while it runs."""
KEY_SUFFIX = ".audit.key"
"""The suffix of key files: ``lineside.toml`` has its key in ``lineside.audit.key``."""


class Site(StrictModel):
    """The plant as people call it."""

    name: Annotated[OneLine, Field(min_length=1, max_length=80)] = "Lineside"
    language: str = "en"
    """The default, where the user has chosen none and the browser requests none that exists."""
    time_zone: str = ""
    """An IANA name such as Europe/Berlin; empty: the machine's own."""
    simulated: StrictBool = False
    """No drive is connected: every page shows it."""
    control: StrictBool = False
    """Whether one user at a time holds control of a line; then no other may set anything."""

    @property
    def zone(self) -> str:
        """The IANA name of the one time zone that everything is shown in."""
        return self.time_zone or machine_zone()

    @field_validator("time_zone")
    @classmethod
    def _zone_is_known(cls, name: str) -> str:
        if name and not is_zone(name):
            raise ValueError(Message("setting_time_zone"))
        return name

    @field_validator("language")
    @classmethod
    def _language_has_a_file(cls, tag: str) -> str:
        known = sorted(catalogs())
        if tag not in known:
            raise ValueError(Message.of("setting_one_of", known=[*known]))
        return tag


def _network(written: object) -> IPv4Network | IPv6Network:
    """Return an address or a network as TOML writes it."""
    try:
        network = ip_network(written) if isinstance(written, str) else None
    except ValueError:
        network = None
    if network is None:
        raise ValueError(Message("setting_proxy"))
    if not network.prefixlen:
        raise ValueError(Message("setting_every_proxy"))
    return network


def host_name(written: str) -> str:
    """Return a name or an address of a host, in small letters. Raise ValueError."""
    bare = written.strip("[]").lower()
    if not _HOST_NAME.fullmatch(bare):
        try:
            ip_address(bare)
        except ValueError:
            raise ValueError(Message("setting_host_name")) from None
    return bare


TrustedNetwork = Annotated[IPv4Network | IPv6Network, BeforeValidator(_network)]
HostName = Annotated[str, AfterValidator(host_name)]


class ServerSettings(StrictModel):
    """Where the dashboard listens and keeps its data."""

    host: Annotated[str, Field(min_length=1)] = "127.0.0.1"
    port: Annotated[int, Field(strict=True, ge=0, le=65535)] = 8000
    """The TCP port; 0 takes any free port."""
    data: Path = Path("data")
    """The data folder, relative to the file; absolute once loaded."""
    trusted_proxies: tuple[TrustedNetwork, ...] = ()
    """Whose X-Forwarded-For, -Proto and -Host are believed."""
    allowed_hosts: tuple[HostName, ...] = ()
    """The names under which the dashboard responds; empty: any."""
    sessions: Sessions = Sessions()
    tls: TlsSettings | None = None
    """The settings of HTTPS and WSS; None: HTTP."""

    @property
    def is_in_clear(self) -> bool:
        """Whether other machines reach the dashboard without TLS."""
        return self.tls is None and not is_loopback(self.host)

    @property
    def store(self) -> Path:
        """The main store: users, events, sets, recipes, limits."""
        return self.data / STORE_FILE


class Settings(StrictModel):
    """The complete configuration."""

    site: Site = Site()
    server: ServerSettings = ServerSettings()
    oidc: OidcSettings | None = None
    history: HistorySettings = HistorySettings()
    audit: Audit = Audit()
    bus: tuple[BusSettings, ...] = ()
    alarm: tuple[AlarmSettings, ...] = ()
    built_in_alarm: tuple[BuiltInAlarmSettings, ...] = ()
    notify: NotifySettings = NotifySettings()
    shift: ShiftSettings = ShiftSettings()
    report: Annotated[tuple[ReportSettings, ...], Field(max_length=50)] = ()
    backup: BackupSettings = BackupSettings()
    postgresql: PostgresqlSettings | None = None
    mqtt: MqttSettings | None = None
    opcua: OpcuaSettings | None = None
    peer: Annotated[tuple[PeerSettings, ...], Field(max_length=200)] = ()
    _file: Path | None = PrivateAttr(None)
    """The configuration file, if it was read from one."""
    _text: str = PrivateAttr("")
    """The text of the configuration file as it was read."""

    @property
    def opcua_address(self) -> tuple[str, int]:
        """The address at which OPC UA is served, if it is."""
        wanted = self.opcua or OpcuaSettings()
        return wanted.host or self.server.host, wanted.port

    @property
    def page_digest(self) -> str:
        """Identifies the static content of a page: the release, and the names of the site and its units."""
        units = [(bus.name, bus.draw_percent, bus.unit) for bus in self.bus]
        return sha256(repr((VERSION, self.site, units)).encode()).hexdigest()[:16]

    @property
    def former_notices(self) -> list[Message]:
        """Notices of the parts of the file and the data folder that an earlier version used and that set
        nothing now."""
        return former_notices(self._text, str(self._file), self.server.data)

    @property
    def key_files(self) -> tuple[Path, ...]:
        """The files where the keys of the audit log are or, in this order, may be made. If none is
        configured, the place beside the configuration comes first; a service may be unable to write there,
        and in the end to anything but its data folder."""
        if self.audit.key_file is not None:
            return (self.audit.key_file,)
        data = self.server.data
        name = f"{self._file.stem if self._file else data.name}{KEY_SUFFIX}"
        folders = (*((self._file.parent,) if self._file else ()), data.parent, data)
        return tuple(dict.fromkeys(folder / name for folder in folders))

    @model_validator(mode="before")
    @classmethod
    def _without_former_keys(cls, data: object) -> object:
        return without_former_keys(data)

    @field_validator("bus")
    @classmethod
    def _names_and_ports_are_unique(cls, buses: tuple[BusSettings, ...]) -> tuple[BusSettings, ...]:
        names: set[str] = set()
        ports: dict[str, str] = {}
        for index, bus in enumerate(buses):
            if bus.name in names:
                message = Message.of("setting_bus_twice", name=bus.name)
                raise setting_fault(message, index, "name")
            names.add(bus.name)
            is_url = "://" in bus.port
            if not is_url and not bus.has_local_port:
                continue  # each machine has its own /dev/ttyUSB0
            # Two names may be of one device: /dev/serial/by-id/… are links.
            port = bus.port if is_url else os.path.realpath(bus.port)
            if port in ports:
                message = Message.of("setting_port_twice", port=bus.port, other=ports[port])
                raise setting_fault(message, index, "port")
            ports[port] = bus.name
        return buses

    @model_validator(mode="after")
    def _alarms_have_their_units(self) -> Settings:
        refuse_misplaced(self.alarm, self.bus)
        refuse_built_in(self.built_in_alarm, self.bus)
        refuse_unknown_names(self.notify, self.bus)
        refuse_repeated(self.peer)
        refuse_unsendable(self.report, self.notify, self.bus)
        return self


def load(path: Path) -> Settings:
    """Read the file. Raise ConfigurationError naming file, line and a correct value."""
    return parse(configuration.read(path), path)


def parse(text: str, path: Path) -> Settings:
    """Parse the text of a file, or one that it may become. Raise ConfigurationError."""
    written = configuration.parse(text, path, Settings)
    settings = written.in_folder(path.resolve().parent)
    server, key_file = settings.server, settings.audit.key_file
    data = server.data.resolve()
    if key_file is not None and key_file.resolve().is_relative_to(data):
        raise ConfigurationError(
            Message.of("configuration_key_in_data", file=str(path), path=str(written.audit.key_file))
        )
    loaded = settings.model_copy(update={"server": server.model_copy(update={"data": data})})
    loaded._file = path.resolve()
    loaded._text = text
    return loaded
