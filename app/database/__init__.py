"""A store: SQLite, where one thread writes, others read, and numbered steps bring it up to date."""

from __future__ import annotations

from app.database.connection import StoreConnection, StoreRow
from app.database.database import Database

__all__ = ["Database", "StoreConnection", "StoreRow"]
