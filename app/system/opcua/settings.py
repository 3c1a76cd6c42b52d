"""The table ``[opcua]`` of lineside.toml."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from bus.settings import StrictModel
from bus.validation import OneLine

if TYPE_CHECKING:
    from app.system.opcua.process import OpcuaProcess

FOLDER = "opcua"
"""The folder in the data folder with the server's certificate and its trusted clients."""
ShortText = Annotated[OneLine, Field(max_length=100)]


class OpcuaSettings(StrictModel):
    """The settings of the OPC UA server."""

    host: Annotated[OneLine, Field(max_length=253)] = ""
    """The address at which it listens; empty: that of the dashboard."""
    port: Annotated[int, Field(strict=True, ge=1, le=65535)] = 4840
    names: Annotated[
        tuple[Annotated[OneLine, Field(min_length=1, max_length=253)], ...], Field(max_length=20)
    ] = ()
    """Further names and addresses of this machine, for the certificate that the first start creates."""
    manufacturer: ShortText = ""
    """The builder of the machine, for its identification."""
    serial_number: ShortText = ""


class OpcuaProcesses(tuple["OpcuaProcess", ...]):
    """The process of this server; empty if none is configured: its code is then not imported."""
