"""Stores recipes: every version, and which one a bus was loaded with last."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from app.core.database import StoreConnection
from app.core.database.connection import upsert
from app.core.database.database import Tables, reading, writing
from app.engineering.recipes.rules import Recipe, RecipeSetpoint
from bus.instants import UnixTime


@dataclass(frozen=True, slots=True)
class Loaded:
    """Which recipe a bus was loaded with, by whom and when (seconds since the epoch)."""

    recipe: Recipe
    who: str
    at: UnixTime


class RecipeStore(Tables):
    """All access to the tables of recipes."""

    @writing
    def save(self, connection: StoreConnection, recipe: Recipe) -> Recipe:
        """Store a new version (one above the highest of that name); returns it with id and version."""
        (version,) = connection.execute(
            "SELECT coalesce(max(version), 0) + 1 FROM recipe WHERE bus = ? AND name = ?",
            (recipe.bus, recipe.name),
        ).fetchone()
        [(recipe_id,)] = connection.execute(
            "INSERT INTO recipe (bus, name, version, comment, who, saved_at)"
            " VALUES (?, ?, ?, ?, ?, ?) RETURNING id",
            (recipe.bus, recipe.name, version, recipe.comment, recipe.who, recipe.saved_at),
        )
        connection.executemany(
            "INSERT INTO recipe_row (recipe_id, unit, raw, kind, scale) VALUES (?, ?, ?, ?, ?)",
            [(recipe_id, one.unit, one.raw, one.kind, one.scale) for one in recipe.setpoints],
        )
        return replace(recipe, version=version, id=recipe_id)

    @reading
    def load(self, connection: StoreConnection, recipe_id: int) -> Recipe | None:
        """One version, None when there is no such."""
        return next(_recipes(connection, [recipe_id]), None)

    @reading
    def newest(self, connection: StoreConnection, bus: str | None = None) -> list[Recipe]:
        """The newest version of every recipe in use, by name."""
        found = connection.execute(
            "SELECT id FROM recipe AS mine WHERE retired = 0 AND (bus = :bus OR :bus IS NULL) AND version ="
            " (SELECT max(version) FROM recipe AS other WHERE other.bus = mine.bus"
            " AND other.name = mine.name) ORDER BY bus, name",
            {"bus": bus},
        )
        return list(_recipes(connection, [recipe_id for (recipe_id,) in found]))

    @reading
    def is_full(self, connection: StoreConnection, bus: str, name: str, most: int) -> bool:
        """Whether one of this name would be more than so many in use."""
        count, is_there = connection.execute(
            "SELECT count(DISTINCT name), coalesce(max(CASE WHEN name = ? THEN 1 END), 0)"
            " FROM recipe WHERE bus = ? AND retired = 0",
            (name, bus),
        ).fetchone()
        return count >= most and not is_there

    @reading
    def versions(self, connection: StoreConnection, bus: str, name: str) -> list[Recipe]:
        """All versions of one recipe, newest first."""
        found = connection.execute(
            "SELECT id FROM recipe WHERE bus = ? AND name = ? ORDER BY version DESC", (bus, name)
        )
        return list(_recipes(connection, [recipe_id for (recipe_id,) in found]))

    @writing
    def retire(self, connection: StoreConnection, bus: str, name: str) -> None:
        """Take a recipe out of the list; its versions stay on record."""
        connection.execute("UPDATE recipe SET retired = 1 WHERE bus = ? AND name = ?", (bus, name))

    @writing
    def mark_loaded(
        self, connection: StoreConnection, bus: str, recipe_id: int, who: str, at: UnixTime
    ) -> None:
        """Record that a recipe was loaded and verified. ``at``: seconds since the epoch."""
        connection.execute(
            upsert("loaded_recipe", ("bus",), ("recipe_id", "who", "loaded_at")),
            (bus, recipe_id, who, at),
        )

    @reading
    def loaded(self, connection: StoreConnection) -> dict[str, Loaded]:
        """Bus → the recipe it was loaded with last."""
        marks = connection.execute("SELECT bus, recipe_id, who, loaded_at FROM loaded_recipe").fetchall()
        return {
            bus: Loaded(recipe, who, at)
            for bus, recipe_id, who, at in marks
            for recipe in _recipes(connection, [recipe_id])
        }


def _recipes(connection: StoreConnection, ids: Iterable[int]) -> Iterator[Recipe]:
    """Those that there are of these versions."""
    for recipe_id in ids:
        heads = connection.execute(
            "SELECT bus, name, comment, who, saved_at, version FROM recipe WHERE id = ?", (recipe_id,)
        )
        rows = connection.execute(
            "SELECT unit, raw, kind, scale FROM recipe_row WHERE recipe_id = ? ORDER BY unit", (recipe_id,)
        )
        setpoints = tuple(RecipeSetpoint(*row) for row in rows)
        for bus, name, comment, who, saved_at, version in heads:
            yield Recipe(bus, name, comment, who, saved_at, setpoints, version, recipe_id)
