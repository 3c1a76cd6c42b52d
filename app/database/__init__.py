"""One SQLite store: one thread writes, others read, numbered SQL files bring it up to date."""

from __future__ import annotations

from app.database.connection import Database, StoreConnection

__all__ = ["Database", "StoreConnection"]
