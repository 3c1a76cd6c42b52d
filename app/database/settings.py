"""``[store]`` of lineside.toml: the database in which everything is stored."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated
from urllib.parse import parse_qsl, urlencode, urlsplit

from pydantic import Field, field_serializer, field_validator
from pydantic_core import PydanticCustomError

from bus.messages import Message
from bus.settings import StrictModel

SCHEMES = ("postgresql", "postgres")
SECRETS = ("password", "sslpassword")
"""Parameters of a URL that are never shown."""


class StoreSettings(StrictModel):
    """Where everything is stored."""

    url: Annotated[str, Field(repr=False)] = ""
    """A URL of libpq, such as ``postgresql://lineside@db/lineside``; empty: SQLite in the data folder."""
    password_file: Path | None = None
    """Its first line is the password. Relative to the configuration; absolute once loaded."""

    @property
    def shown(self) -> str:
        """The URL without what is secret."""
        return without_secrets(self.url)

    def in_folder(self, folder: Path) -> StoreSettings:
        """With an absolute path."""
        if self.password_file is None:
            return self
        return self.model_copy(update={"password_file": folder / self.password_file.expanduser()})

    @field_validator("url")
    @classmethod
    def _url_is_of_postgresql(cls, url: str) -> str:
        if url and not _is_of_postgresql(url):
            # This kind of error is shown without the value.
            message = Message("setting_store_url")
            raise PydanticCustomError("store_url", "no database", {"message": message, "at": ()})
        return url

    @field_serializer("url")
    def _dump_without_secrets(self, _: str) -> str:
        return self.shown


IN_FILES = StoreSettings()
"""SQLite in the data folder."""


def _is_of_postgresql(url: str) -> bool:
    try:
        parts = urlsplit(url)
    except ValueError:
        return False
    return parts.scheme in SCHEMES and bool(parts.path.strip("/")) and not parts.fragment


def without_secrets(url: str) -> str:
    """A URL without the passwords that it contains. Pure."""
    parts = urlsplit(url)
    account, at, hosts = parts.netloc.rpartition("@")
    query = parse_qsl(parts.query, keep_blank_values=True)
    shown = urlencode([(name, value) for name, value in query if name not in SECRETS], safe="/:,")
    netloc = f"{account.partition(':')[0]}{at}{hosts}"
    # Not `urlunsplit`: it would leave out the slashes before an empty host.
    return f"{parts.scheme}://{netloc}{parts.path}{'?' if shown else ''}{shown}" if url else ""
