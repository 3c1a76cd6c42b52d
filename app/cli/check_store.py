"""The main store before a command opens it: one that is missing is replaced by a new one on request only."""

from __future__ import annotations

from app.audit.keys import find_key_file
from app.database.presence import presence_of, refusal_to_start
from app.errors import StoreError
from app.settings import Settings


def check_store(settings: Settings, *, new: bool = False) -> None:
    """Raises StoreError where the main store is missing, empty or damaged and no first start explains that;
    with ``new`` where one is there."""
    store = settings.server.store
    refusal = refusal_to_start(store, presence_of(store), find_key_file(settings.key_files), new=new)
    if refusal is not None:
        raise StoreError(refusal)
