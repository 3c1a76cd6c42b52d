"""The table ``[mqtt]`` of lineside.toml."""

from __future__ import annotations

import re
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field, StrictBool, model_validator

from app.core.server.settings import is_loopback
from bus.messages import Message
from bus.settings import StrictModel
from bus.validation import OneLine, setting_fault

PORTS = {"mqtt": 1883, "mqtts": 8883}
_RESERVED = re.compile(r"[/+#]")
Deadband = Annotated[Decimal, Field(ge=0, le=100_000)]


def _url(written: str) -> str:
    """Return the URL of a broker. Raise ValueError for another URL, and for one with a password: the
    configuration is shown, recorded and backed up."""
    try:
        parts = urlsplit(written)
        port, host = parts.port, parts.hostname
    except ValueError:
        raise ValueError(Message("setting_mqtt_url")) from None
    if parts.username is not None or parts.password is not None:
        raise ValueError(Message("setting_mqtt_password"))
    more = parts.path.strip("/") or parts.query or parts.fragment
    if parts.scheme not in PORTS or not host or port == 0 or more:
        raise ValueError(Message("setting_mqtt_url"))
    return written


def _identifier(written: str) -> str:
    if _RESERVED.search(written):
        raise ValueError(Message("setting_mqtt_identifier"))
    return written


Identifier = Annotated[OneLine, Field(max_length=80), AfterValidator(_identifier)]


def identifier_of(name: str) -> str:
    """Return a name as a Sparkplug id, which may not hold ``/``, ``+`` or ``#`` (Sparkplug 3.0, 4.1)."""
    return _RESERVED.sub("-", name).strip() or "-"


class Deadbands(StrictModel):
    """The least difference, in its own unit, at which a value is sent again; 0: any change."""

    actual: Deadband = Decimal(0)
    commanded: Deadband = Decimal(0)
    analog: Deadband = Decimal(0)


class MqttSettings(StrictModel):
    """The broker to which each line is published as a Sparkplug B edge node."""

    url: Annotated[str, Field(max_length=500), AfterValidator(_url)]
    ca_file: Path | None = None
    """The certificate authorities to trust instead of those of the machine."""
    certificate: Path | None = None
    key: Path | None = None
    username: Annotated[OneLine, Field(max_length=200)] = ""
    password_file: Path | None = None
    group: Identifier = ""
    """The Sparkplug group; empty: the name of the site."""
    primary_host: Identifier = ""
    """The host application whose absence makes the nodes wait; empty: none."""
    deadband: Deadbands = Deadbands()
    overview: StrictBool = False
    """Whether to show the lines that other servers publish on this broker."""

    @model_validator(mode="after")
    def _files_belong_together(self) -> MqttSettings:
        pairs: tuple[tuple[Literal["certificate", "key", "username", "password_file"], ...], ...] = (
            ("certificate", "key"),
            ("key", "certificate"),
            ("password_file", "username"),
        )
        for name, needed in pairs:
            if getattr(self, name) and not getattr(self, needed):
                message = Message.of("setting_mqtt_needs", name=name, needed=needed)
                raise setting_fault(message, name)
        if not self.uses_tls and (self.certificate or self.ca_file):
            raise setting_fault(Message("setting_mqtt_no_tls"), "url")
        return self

    @property
    def uses_tls(self) -> bool:
        """Whether the connection is encrypted."""
        return urlsplit(self.url).scheme == "mqtts"

    @property
    def host(self) -> str:
        """The host of the broker."""
        return urlsplit(self.url).hostname or ""

    @property
    def port(self) -> int:
        """The port of the broker."""
        parts = urlsplit(self.url)
        return parts.port or PORTS[parts.scheme]

    @property
    def place(self) -> str:
        """The name of the broker in messages."""
        return f"{self.host}:{self.port}"

    @property
    def is_in_clear(self) -> bool:
        """Whether values and password pass other machines without TLS."""
        return not self.uses_tls and not is_loopback(self.host)
