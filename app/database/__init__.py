"""A store: one thread writes, others read, numbered steps bring it up to date."""

from __future__ import annotations

from app.database.database import Database
from app.database.sqlite.connection import SqliteDatabase
from app.database.store_connection import StoreConnection, StoreRow

__all__ = ["Database", "SqliteDatabase", "StoreConnection", "StoreRow"]
