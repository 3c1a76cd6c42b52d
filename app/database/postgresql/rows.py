"""Rows of PostgreSQL by index and by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

from psycopg import Cursor


class NamedRow(tuple[Any, ...]):
    """A row of a statement. Each list of columns has a subclass."""

    __slots__ = ()
    places: dict[str, int]

    def __getitem__(self, key: Any, /) -> Any:
        return tuple.__getitem__(self, self.places[key] if type(key) is str else key)

    def keys(self) -> list[str]:
        return list(self.places)


@lru_cache(1024)
def _kind_of(names: tuple[bytes | None, ...]) -> type[NamedRow]:
    places = {(name or b"").decode(): place for place, name in enumerate(names)}
    return type("NamedRow", (NamedRow,), {"__slots__": (), "places": places})


def named_row(cursor: Cursor[Any]) -> Callable[[Sequence[Any]], NamedRow]:
    """A row factory of psycopg."""
    found = cursor.pgresult
    return NamedRow if found is None else _kind_of(tuple(map(found.fname, range(found.nfields))))
