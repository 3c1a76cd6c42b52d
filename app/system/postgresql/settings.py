"""The table ``[postgresql]`` of lineside.toml."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import parse_qsl, unquote, urlsplit

from pydantic import AfterValidator, Field

from bus.messages import Message
from bus.settings import StrictModel

Step = Literal["all", "200 ms", "500 ms", "1 s", "2 s", "5 s", "10 s", "15 s", "30 s", "1 min"]
STEPS_US: dict[Step, int] = {
    "all": 0,
    "200 ms": 200_000,
    "500 ms": 500_000,
    "1 s": 1_000_000,
    "2 s": 2_000_000,
    "5 s": 5_000_000,
    "10 s": 10_000_000,
    "15 s": 15_000_000,
    "30 s": 30_000_000,
    "1 min": 60_000_000,
}
"""The step of each setting in µs, each a divisor of a minute; 0: every reading."""


def _url(written: str) -> str:
    """Return a URL for libpq without a password: the configuration is shown, recorded and backed up."""
    try:
        parts = urlsplit(written)
        has_password = parts.password is not None or "password" in dict(parse_qsl(parts.query))
    except ValueError:
        raise ValueError(Message("setting_postgresql_url")) from None
    if parts.scheme not in ("postgresql", "postgres"):
        raise ValueError(Message("setting_postgresql_url"))
    if has_password:
        raise ValueError(Message("setting_postgresql_password"))
    return written


class PostgresqlSettings(StrictModel):
    """The database in which stored data is published as rows, and the density of the rows."""

    url: Annotated[str, Field(max_length=2000), AfterValidator(_url)]
    password_file: Path | None = None
    """Relative to the configuration; absolute once loaded. None: as libpq finds the password."""
    db_schema: Annotated[str, Field(alias="schema", pattern=r"^[a-z_][a-z0-9_]*$", max_length=40)] = (
        "lineside"
    )
    readings: Step = "1 s"
    keep_months: Annotated[int, Field(strict=True, ge=1, le=1200)] | None = None
    """The complete months before the current one that stay in the database; None: all."""

    @property
    def step(self) -> int:
        """The distance of two rows of a unit, µs; 0: every reading is a row."""
        return STEPS_US[self.readings]

    @property
    def quoted_schema(self) -> str:
        """The name of the schema, quoted for SQL."""
        return f'"{self.db_schema}"'

    @property
    def place(self) -> str:
        """The name of the database in messages: host and database, without the user."""
        parts = urlsplit(self.url)
        query = dict(parse_qsl(parts.query))
        host = parts.netloc.rpartition("@")[2] or query.get("host", "localhost")
        return f"{unquote(host)}/{query.get('dbname') or parts.path.lstrip('/')}"
