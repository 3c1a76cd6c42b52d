"""Where the stores of a site are: files in a folder, or the schemas of a database."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

from app.database.copying import files
from app.database.copying.sides import CopyTarget, StoreSide
from app.database.opening import require_driver
from app.database.settings import StoreSettings


@dataclass(frozen=True, slots=True)
class StorePart:
    """One of the stores of a site. ``name``: of its schema; ``file``: in the data folder; ``steps``: the
    folder of its steps."""

    name: str
    file: str
    steps: Path


@dataclass(frozen=True, slots=True)
class Folder:
    """Files of SQLite in a folder."""

    path: Path

    @property
    def name(self) -> str:
        return str(self.path)

    def has(self, part: StorePart) -> bool:
        """Whether there is anything of a store."""
        file = self.path / part.file
        return file.exists() and file.stat().st_size > 0

    def reading(self, part: StorePart) -> AbstractContextManager[StoreSide]:
        return files.reading(self.path / part.file)

    def writing(self, part: StorePart) -> AbstractContextManager[CopyTarget]:
        return files.writing(self.path / part.file, part.steps)


@dataclass(frozen=True, slots=True)
class PostgresqlPlace:
    """Schemas of a database of PostgreSQL."""

    store: StoreSettings

    @property
    def name(self) -> str:
        return self.store.shown

    def has(self, part: StorePart) -> bool:
        """Whether there is anything of a store."""
        require_driver()
        from app.database.engine import tables_in

        with self.reading(part) as side, side.in_words():
            return bool(tables_in(side.connection))

    def reading(self, part: StorePart) -> AbstractContextManager[StoreSide]:
        require_driver()
        from app.database.postgresql import copying

        return copying.reading(self.store, part.name)

    def writing(self, part: StorePart) -> AbstractContextManager[CopyTarget]:
        require_driver()
        from app.database.postgresql import copying

        return copying.writing(self.store, part.name, part.steps)

    def servers(self) -> int:
        """How many connections servers have to the database."""
        require_driver()
        from app.database.postgresql import copying

        return copying.servers_of(self.store)


StorePlace = Folder | PostgresqlPlace
