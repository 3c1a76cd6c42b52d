"""Queries as methods: written once with the connection as a parameter, called without it."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar

from app.database.database import Database
from app.database.store_connection import StoreConnection

P = ParamSpec("P")
T = TypeVar("T")
TablesT = TypeVar("TablesT", bound="Tables")
Query = Callable[Concatenate[TablesT, StoreConnection, P], T]
QueryCall = Callable[Concatenate[TablesT, P], Coroutine[Any, Any, T]]


class Tables:
    """Some tables of a database. The queries of a subclass are its methods."""

    def __init__(self, database: Database) -> None:
        self.database = database


def reading(query: Query[TablesT, P, T]) -> QueryCall[TablesT, P, T]:
    """Run the query in a thread, on a connection that cannot write."""

    @wraps(query)
    async def call(tables: TablesT, /, *args: P.args, **kwargs: P.kwargs) -> T:
        return await tables.database.read(lambda connection: query(tables, connection, *args, **kwargs))

    return call


def writing(query: Query[TablesT, P, T]) -> QueryCall[TablesT, P, T]:
    """Run the query as one transaction on the writer's thread; it is on disk when the call returns."""

    @wraps(query)
    async def call(tables: TablesT, /, *args: P.args, **kwargs: P.kwargs) -> T:
        return await tables.database.write(lambda connection: query(tables, connection, *args, **kwargs))

    return call
