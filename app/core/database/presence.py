"""Whether a store is in its place, and whether a server may start on it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal

from app.core.database.connection import STEPS, examining, is_intact
from app.core.database.words import in_words
from app.errors import DamagedStoreError
from bus.messages import Message

Presence = Literal["sound", "missing", "empty", "damaged"]


def refusal_to_start(store: Path, presence: Presence, key: Path | None, *, new: bool) -> Message | None:
    """Why a server does not start on a store; None where it may. ``key``: the key file of its audit log where
    there is one, which is made together with the store. ``new``: a new site is what is wanted. Pure."""
    match presence:
        case "sound":
            return Message.of("store_not_new", path=str(store)) if new else None
        case "damaged":
            return None if new else Message.of("store_damaged_at_start", path=str(store))
        case "missing" | "empty":
            if new or key is None:
                return None
            return Message.of(f"store_{presence}_at_start", path=str(store), key=str(key))


def presence_of(store: Path) -> Presence:
    """Whether a store is there, by a first look; nothing is created. Raises StoreError where that fails."""
    try:
        with in_words(store):
            if not store.exists():
                return "missing"
            if not store.stat().st_size:
                return "empty"
            with examining(store) as connection:
                return "sound" if connection.execute("SELECT 1 FROM sqlite_master").fetchone() else "empty"
    except DamagedStoreError:
        return "damaged"


def proves_intact(store: Path, stop: Callable[[], bool]) -> bool:
    """Check every page of a store, or until ``stop`` returns true. Raises StoreError when it ended early."""
    try:
        with examining(store) as connection:
            connection.set_progress_handler(stop, STEPS)
            return is_intact(connection)
    except DamagedStoreError:
        return False
