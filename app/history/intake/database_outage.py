"""What the writer needs of an absence of its database."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from app.database import Database
from app.history.intake.updates import Delivery
from app.history.status import HistoryStatus
from app.history.store.inspection import FoundDamage
from bus.instants import Monotonic


class DatabaseOutage(Protocol):
    """Keeps what was taken in while the database is away, and stores it afterwards."""

    def begin(self) -> None:
        """The store cannot be written."""

    def keep(self, deliveries: Sequence[Delivery], *, is_repeated: bool) -> None:
        """To the disk. Raises OSError; then they are repeated."""

    def attach(self, database: Database, on_damage: FoundDamage) -> None:
        """The store that can be written again; the thread that opens it calls this. Raises StoreError."""

    def end(self) -> None:
        """The attached store is written from now on, and followed."""

    def follow(self, deadline: Monotonic) -> None:
        """Store what was kept until ``deadline`` (monotonic seconds). Raises StoreError, OSError."""

    @property
    def is_following(self) -> bool:
        """Whether something that was kept is not stored yet."""

    def with_spool(self, status: HistoryStatus) -> HistoryStatus:
        """The state of the history with what is kept here."""
