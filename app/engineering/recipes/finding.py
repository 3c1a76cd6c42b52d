"""Finds recipes by their name and their comment."""

from __future__ import annotations

from collections.abc import Iterable

from app.core.find.finders import FoundPlace, Search, matched
from app.engineering.recipes.store import RecipeStore


class RecipeFinder:
    def __init__(self, store: RecipeStore) -> None:
        self._store = store

    async def __call__(self, search: Search) -> Iterable[FoundPlace]:
        """The newest version of each recipe in use."""
        return [
            place
            for recipe in await self._store.newest()
            for place in matched(
                search,
                FoundPlace(recipe.name, f"/recipes/{recipe.id}", recipe.bus, is_name=True),
                recipe.name,
                recipe.comment,
            )
        ]
