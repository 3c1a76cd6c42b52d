"""Copies of a store that were made beside it: of each kind the newest two stay."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path
from typing import Literal

import structlog

CopyKind = Literal["before", "damaged"]
"""Made before a step to a newer version; put aside because pages were damaged."""
MAX_COPIES = 2
COMPANIONS = ("-wal", "-shm")
"""What SQLite has beside a store in WAL mode."""
log = structlog.get_logger()


def copy_of(store: Path, kind: CopyKind, label: str) -> Path:
    """The name of a copy. Labels of a kind sort by age: the number of a step, a UTC time."""
    return store.with_name(f"{store.name}.{kind}-{label}")


def put_aside(store: Path) -> Path:
    """Rename a damaged store that is closed, with its companions; return its new name."""
    aside = copy_of(store, "damaged", time.strftime("%Y%m%dT%H%M%SZ", time.gmtime()))
    for suffix in ("", *COMPANIONS):
        with suppress(FileNotFoundError):
            store.with_name(store.name + suffix).rename(aside.with_name(aside.name + suffix))
    remove_older_copies(store, "damaged")
    return aside


def remove_older_copies(store: Path, kind: CopyKind) -> None:
    """Remove all but the newest `MAX_COPIES`, each with its companions. One that cannot be removed stays."""
    found = store.parent.glob(copy_of(store, kind, "*").name)
    copies = sorted(path for path in found if not path.name.endswith(COMPANIONS))
    for copy in copies[:-MAX_COPIES]:
        try:
            for suffix in ("", *COMPANIONS):
                copy.with_name(copy.name + suffix).unlink(missing_ok=True)
        except OSError as error:
            log.warning("copy of a store not removed", path=str(copy), error=str(error))
