"""Whether a store is a copy that ``lineside migrate-store`` has not finished."""

from __future__ import annotations

from app.errors import StoreError
from bus.messages import Message

LEDGER = "copying"
"""The table that a store has until its copy is finished."""


def refuse_unfinished(name: str, *, has_ledger: bool) -> None:
    """Raises StoreError where a store is half of a site."""
    if has_ledger:
        raise StoreError(Message.of("store_unfinished", path=name))
