"""Stores recipes: every version, and which one a bus was loaded with last."""

from __future__ import annotations

import sqlite3
from dataclasses import dataclass

from app.database import Database
from app.recipes.rules import Recipe, RecipeSetpoint
from bus.instants import UnixTime


@dataclass(frozen=True, slots=True)
class Loaded:
    """Which recipe a bus was loaded with, by whom and when (seconds since the epoch)."""

    recipe: Recipe
    who: str
    at: UnixTime


class RecipeStore:
    """All access to the tables of recipes."""

    def __init__(self, database: Database) -> None:
        self._database = database

    async def save(self, recipe: Recipe) -> Recipe:
        """Store a new version (one above the highest of that name); returns it with id and version."""
        recipe_id = await self._database.write(lambda connection: _insert(connection, recipe))
        stored = await self.load(recipe_id)
        assert stored is not None
        return stored

    async def load(self, recipe_id: int) -> Recipe | None:
        """One version, None when there is no such."""
        return await self._database.read(lambda connection: _load(connection, recipe_id))

    async def newest(self, bus: str | None = None) -> list[Recipe]:
        """The newest version of every recipe in use, by name."""
        return await self._database.read(lambda connection: _newest(connection, bus))

    async def is_full(self, bus: str, name: str, most: int) -> bool:
        """Whether one of this name would be more than so many in use."""
        query = (
            "SELECT count(DISTINCT name), ifnull(max(name = ?), 0) FROM recipe WHERE bus = ? AND retired = 0"
        )
        count, is_there = await self._database.read(
            lambda connection: connection.execute(query, (name, bus)).fetchone()
        )
        return count >= most and not is_there

    async def versions(self, bus: str, name: str) -> list[Recipe]:
        """All versions of one recipe, newest first."""

        def work(connection: sqlite3.Connection) -> list[Recipe]:
            ids = connection.execute(
                "SELECT id FROM recipe WHERE bus = ? AND name = ? ORDER BY version DESC", (bus, name)
            ).fetchall()
            return _load_all(connection, ids)

        return await self._database.read(work)

    async def retire(self, bus: str, name: str) -> None:
        """Take a recipe out of the list; its versions stay on record."""
        await self._database.write(
            lambda connection: connection.execute(
                "UPDATE recipe SET retired = 1 WHERE bus = ? AND name = ?", (bus, name)
            )
        )

    async def mark_loaded(self, bus: str, recipe_id: int, who: str, at: UnixTime) -> None:
        """Record that a recipe was loaded and verified. ``at``: seconds since the epoch."""
        await self._database.write(
            lambda connection: connection.execute(
                "INSERT OR REPLACE INTO loaded_recipe (bus, recipe_id, who, loaded_at) VALUES (?, ?, ?, ?)",
                (bus, recipe_id, who, at),
            )
        )

    async def loaded(self) -> dict[str, Loaded]:
        """Bus → the recipe it was loaded with last."""
        return await self._database.read(_loaded)


def _insert(connection: sqlite3.Connection, recipe: Recipe) -> int:
    (version,) = connection.execute(
        "SELECT coalesce(max(version), 0) + 1 FROM recipe WHERE bus = ? AND name = ?",
        (recipe.bus, recipe.name),
    ).fetchone()
    cursor = connection.execute(
        "INSERT INTO recipe (bus, name, version, comment, who, saved_at) VALUES (?, ?, ?, ?, ?, ?)",
        (recipe.bus, recipe.name, version, recipe.comment, recipe.who, recipe.saved_at),
    )
    recipe_id = int(cursor.lastrowid or 0)
    connection.executemany(
        "INSERT INTO recipe_row VALUES (?, ?, ?, ?)",
        [(recipe_id, setpoint.unit, setpoint.raw, setpoint.kind) for setpoint in recipe.setpoints],
    )
    return recipe_id


def _load(connection: sqlite3.Connection, recipe_id: int) -> Recipe | None:
    head = connection.execute(
        "SELECT bus, name, comment, who, saved_at, version FROM recipe WHERE id = ?", (recipe_id,)
    ).fetchone()
    if head is None:
        return None
    rows = connection.execute(
        "SELECT unit, raw, kind FROM recipe_row WHERE recipe_id = ? ORDER BY unit", (recipe_id,)
    )
    bus, name, comment, who, saved_at, version = head
    setpoints = tuple(RecipeSetpoint(*row) for row in rows)
    return Recipe(bus, name, comment, who, saved_at, setpoints, version, recipe_id)


def _load_all(connection: sqlite3.Connection, ids: list[tuple[int]]) -> list[Recipe]:
    recipes = (_load(connection, recipe_id) for (recipe_id,) in ids)
    return [recipe for recipe in recipes if recipe is not None]


def _newest(connection: sqlite3.Connection, bus: str | None) -> list[Recipe]:
    ids = connection.execute(
        "SELECT id FROM recipe AS mine WHERE retired = 0 AND (:bus IS NULL OR bus = :bus) AND version ="
        " (SELECT max(version) FROM recipe AS other WHERE other.bus = mine.bus AND other.name = mine.name)"
        " ORDER BY bus, name",
        {"bus": bus},
    ).fetchall()
    return _load_all(connection, ids)


def _loaded(connection: sqlite3.Connection) -> dict[str, Loaded]:
    found: dict[str, Loaded] = {}
    rows = connection.execute("SELECT bus, recipe_id, who, loaded_at FROM loaded_recipe").fetchall()
    for bus, recipe_id, who, at in rows:
        recipe = _load(connection, recipe_id)
        if recipe is not None:
            found[bus] = Loaded(recipe, who, at)
    return found
