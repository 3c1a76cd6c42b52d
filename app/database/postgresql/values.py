"""Values as SQLite has them: truth is 0 or 1, every integer has 64 bits, a sum is no decimal number."""

from __future__ import annotations

from decimal import Decimal

import psycopg
from psycopg.abc import Buffer
from psycopg.adapt import AdaptersMap, Dumper, Loader
from psycopg.postgres import types
from psycopg.pq import Format
from psycopg.types.numeric import Int8Dumper, NumericBinaryLoader


class FlagDumper(Dumper):
    """Truth as an integer."""

    oid = types["int8"].oid

    def dump(self, obj: bool) -> bytes:
        return b"1" if obj else b"0"


class FlagLoader(Loader):
    """A condition in a list of columns as 0 or 1."""

    format = Format.BINARY

    def load(self, data: Buffer) -> int:
        return int(bytes(data) == b"\x01")


class SumLoader(NumericBinaryLoader):
    """A decimal number, such as a sum of integers, as an integer where it is one."""

    def load(self, data: Buffer) -> int | float:  # type: ignore[override]
        number: Decimal = super().load(data)
        return int(number) if number == number.to_integral_value() else float(number)


def adapters() -> AdaptersMap:
    """How values go to the database and come from it."""
    adapted = AdaptersMap(psycopg.adapters)
    adapted.register_dumper(int, Int8Dumper)
    adapted.register_dumper(bool, FlagDumper)
    adapted.register_loader("bool", FlagLoader)
    adapted.register_loader("numeric", SumLoader)
    return adapted


ADAPTERS = adapters()
