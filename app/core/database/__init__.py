"""A store: SQLite, where one thread writes, others read, and numbered steps bring it up to date."""

from __future__ import annotations

from app.core.database.connection import StoreConnection, StoreRow
from app.core.database.database import Database

__all__ = ["Database", "StoreConnection", "StoreRow"]
