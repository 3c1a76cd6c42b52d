"""The settings of a bus and its units (``[[bus]]`` of lineside.toml)."""

from __future__ import annotations

import re
from decimal import Decimal
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self
from urllib.parse import urlsplit

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    field_validator,
    model_validator,
)

from bus.messages import Message
from bus.validation import OneLine, setting_fault

Baud = Literal[300, 600, 1200, 2400, 4800, 9600]
BAUDS: tuple[Baud, ...] = (300, 600, 1200, 2400, 4800, 9600)
BITS_PER_BYTE = 10
"""The bits of a byte: 8 data bits, no parity, 1 stop bit and the start bit (manual, 2.0.3)."""


def wire_seconds(byte_count: int, baud: int) -> float:
    return byte_count * BITS_PER_BYTE / baud


class StrictModel(BaseModel):
    """The base of settings: immutable, and an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    def in_folder(self, folder: Path) -> Self:
        """Return these settings with absolute paths; relative ones are in ``folder``."""
        absolute = {name: _in_folder(value, folder) for name, value in self}
        return self.model_copy(
            update={name: value for name, value in absolute.items() if value != getattr(self, name)}
        )


def _in_folder(value: Any, folder: Path) -> Any:
    match value:
        case Path():
            return folder / value.expanduser()
        case StrictModel():
            return value.in_folder(folder)
        case tuple():
            return tuple(_in_folder(each, folder) for each in value)
    return value


class Dialect(StrictModel):
    """The open points of the manual, decided for one bus. Real units show which is right."""

    checksum_10h: Literal["once", "twice"] = "once"
    """Whether a checksum byte of 10h is sent once or doubled like data."""
    parameter_reply_bytes: Literal[0, 1, 2, 4] = 0
    """Width of the 85h reply; 0 accepts 1, 2 and 4 bytes."""
    parameter_numbers: Literal["binary", "bcd"] = "binary"
    """The form of PRM: sixteen as 10h or, for a unit that counts in BCD, as 16h."""
    follower_speed: Literal["speed", "ratio"] = "speed"
    """The meaning of CS and AS while #8 makes the unit a follower."""
    estop_healthy: Literal[0, 1] = 1
    """The value of the e-stop input bit while no emergency stop is active."""

    @field_validator("parameter_reply_bytes", "estop_healthy", mode="before")
    @classmethod
    def _is_a_number(cls, value: object) -> object:
        """Reject TOML's true, which Python takes for 1 although its author may mean the opposite."""
        if type(value) is not int:
            raise ValueError(Message("setting_integer"))
        return value


Label = Annotated[OneLine, Field(max_length=80)]


class UnitLabels(StrictModel):
    """The names of the devices wired to a unit."""

    output: dict[Annotated[int, Field(ge=1, le=6)], Label] = {}
    input: dict[Literal["run", "estop", "preset", "reverse", "up", "down", "slave"], Label] = {}
    analog: Label = ""
    analog_unit: Label = ""
    unit: Label = ""
    """The measure that the display shows, such as m/min."""


def _check_band(value: object, check: ValidatorFunctionWrapHandler) -> tuple[Decimal, ...]:
    """Return a band that is valid. Raise one ValueError, however many faults it has."""
    try:
        band: tuple[Decimal, ...] = check(value)
    except ValidationError:
        band = (Decimal(0),)
    if band and (len(band) != 2 or band[0] >= band[1]):
        raise ValueError(Message("setting_draw_band"))
    return band


DrawBand = Annotated[
    tuple[Annotated[Decimal, Field(ge=-100, le=1000, decimal_places=1)], ...], WrapValidator(_check_band)
]
"""The lowest and the highest draw of a section, in percent; empty if none is checked."""


class Seam(NamedTuple):
    """The transition from one section to the next: the unit ``before``, and the band of the draw."""

    before: int
    band: DrawBand


class UnitSettings(StrictModel):
    """A DIGIMAX IV: its address (#17) and its name on the floor."""

    id: Annotated[int, Field(strict=True, ge=1, le=255)]
    name: Annotated[OneLine, Field(min_length=1, max_length=60)]
    group: Label = ""
    draw_percent: DrawBand | None = None
    """Band of the draw to the unit before; None for that of the bus."""
    labels: UnitLabels = UnitLabels()


FORMER_KEYS_OF_BUS = ("take_over",)
"""Keys of version 0.2, which are ignored."""


class BusSettings(Dialect):
    """An RS-422 cable, its port, its dialect and its units in floor order."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9]([a-z0-9-]*[a-z0-9])?$", max_length=40)]
    port: Annotated[str, Field(min_length=1)]
    baud: Baud = 9600
    turnaround_ms: Annotated[float, Field(strict=True, ge=0, le=5000)] = 50
    max_scan_hz: Annotated[float, Field(strict=True, ge=0.1, le=100)] | None = None
    """The most times a second that all units are polled; None: as often as the wire allows."""
    worker: Literal["server", "remote"] = "server"
    """The place of the worker: the server, or ``lineside worker`` on the machine with the port."""
    draw_percent: DrawBand = ()
    """Band of the draw of each unit that sets none itself."""
    unit: tuple[UnitSettings, ...] = ()

    @model_validator(mode="before")
    @classmethod
    def _without_former_keys(cls, data: Any) -> Any:
        """Ignore keys of an earlier version, so that no line stops at an upgrade."""
        if not isinstance(data, dict):
            return data
        return {key: value for key, value in data.items() if key not in FORMER_KEYS_OF_BUS}

    @field_validator("unit")
    @classmethod
    def _units_make_a_line(cls, units: tuple[UnitSettings, ...]) -> tuple[UnitSettings, ...]:
        seen: set[int] = set()
        for index, unit in enumerate(units):
            if unit.id in seen:
                message = Message.of("setting_unit_twice", unit=unit.id)
                raise setting_fault(message, index, "id")
            seen.add(unit.id)
        if units and units[0].draw_percent:
            message = Message.of("setting_draw_of_first", name=units[0].name)
            raise setting_fault(message, 0, "draw_percent")
        return units

    @field_validator("port")
    @classmethod
    def _port_is_one_we_open(cls, port: str) -> str:
        return check_port(port)

    @property
    def dialect(self) -> Dialect:
        return Dialect.model_validate({name: getattr(self, name) for name in Dialect.model_fields})

    @property
    def seams(self) -> dict[int, Seam]:
        """The seam before each unit but the first, by its address."""
        return {
            unit.id: Seam(before.id, self.draw_percent if unit.draw_percent is None else unit.draw_percent)
            for before, unit in pairwise(self.unit)
        }

    @property
    def has_local_port(self) -> bool:
        """Whether the port is a device of the server's machine."""
        return self.worker == "server" and "://" not in self.port

    @property
    def least_scan_s(self) -> float:
        """The shortest time in seconds that a scan may take; 0 without a limit."""
        return 0.0 if self.max_scan_hz is None else 1 / self.max_scan_hz

    @property
    def turnaround_s(self) -> float:
        """The time in seconds within which a unit begins its response."""
        return self.turnaround_ms / 1000


_WINDOWS_PORT = re.compile(r"(?i)(\\\\\.\\)?COM\d+:?")
_ADDRESS = re.compile(r"(?i)(?:socket:|rfc2217:|tcp:)?((?:[a-z0-9._-]+|\[[0-9a-f:.]+\]):\d+)")
_WITH_RATE = re.compile(r"(/dev/\w+)[:,@](\d+)")
PORT_EXAMPLE = "/dev/ttyUSB0"


def check_port(port: str) -> str:
    """Check the text of a port. Raise ValueError if it is neither a path nor a URL that can be opened."""
    if not port or not port.isprintable() or port != port.strip():
        raise ValueError(Message("setting_device_path"))
    fault = _url_fault(port) if "://" in port else _path_fault(port)
    if fault is not None:
        raise ValueError(fault)
    return port


def _url_fault(url: str) -> Message | None:
    if not url.startswith(("socket://", "rfc2217://")):
        return Message("setting_port_scheme")
    if "@" in url:
        # No device server requires sign-in, and a port is shown on pages.
        return Message("setting_url_with_password")
    return None if _names_host_and_port(url) else Message("setting_host_and_port")


def _path_fault(path: str) -> Message | None:
    """Return why ``path`` cannot be that of one device of this machine, or None."""
    if _WINDOWS_PORT.fullmatch(path):
        return Message.of("setting_port_of_windows", example=PORT_EXAMPLE)
    if address := _ADDRESS.fullmatch(path):
        return Message.of("setting_port_without_scheme", example=f"socket://{address[1]}")
    if re.fullmatch(r"[\d.]+", path):
        return Message.of("setting_port_without_scheme", example=f"socket://{path}:4001")
    if re.match(r"(?i)(?:socket|rfc2217|tcp|telnet):", path):
        return Message("setting_port_scheme")
    if any(sign in path for sign in "*?[]{}"):
        return Message("setting_port_pattern")
    if not path.startswith("/"):
        example = f"/dev/{path}" if re.fullmatch(r"tty\w+", path) else PORT_EXAMPLE
        return Message.of("setting_port_relative", example=example)
    if with_rate := _WITH_RATE.fullmatch(path):
        return Message.of("setting_port_with_rate", path=with_rate[1], baud=int(with_rate[2]))
    return Message("setting_port_folder") if path.endswith("/") else None


def _names_host_and_port(url: str) -> bool:
    parts = urlsplit(url)
    try:
        is_complete = bool(parts.hostname) and bool(parts.port)
    except ValueError:
        return False
    return is_complete and not (parts.path.strip("/") or parts.query or parts.fragment or " " in url)
