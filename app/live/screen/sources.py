"""What pages and API show that no worker reports: each of these owners is asked for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from app.live.screen.fields import Translator

UnitSubscriber = Callable[[str, int], None]
"""Called with the bus and the address of a unit of which something changed."""


class Drifted(NamedTuple):
    """In which parameters a unit departs from its golden set and who did that: ``words`` for the line, and a
    ``key`` that is another whenever the list on the unit's page is. Both empty where nothing is golden."""

    words: str = ""
    key: str = ""


class UnitGuards(Protocol):
    """Which units are blocked, and who controls a bus."""

    def block_reason(self, bus: str, unit: int) -> str:
        """Why commands to a unit are blocked and by whom; empty when they are not."""

    def holder(self, bus: str) -> str:
        """The account that controls a bus; empty when there is none."""

    def on_block(self, subscriber: UnitSubscriber) -> None:
        """Call ``subscriber`` when a unit was blocked or released."""


class GoldenDrift(Protocol):
    """How units differ from their golden sets."""

    def summary(self, bus: str, unit: int, voice: Translator, now: float) -> Drifted:
        """The differences of a unit in the reader's language. ``now``: Unix time in seconds."""

    def on_change(self, subscriber: UnitSubscriber) -> None:
        """Call ``subscriber`` when the differences of a unit have changed."""


class LoadedRecipes(Protocol):
    """Which recipe each bus runs."""

    def loaded_words(self, bus: str) -> tuple[str, list[str]] | None:
        """The recipe loaded last and the names of the units that differ from it since; None without one."""


@dataclass(frozen=True, slots=True)
class Sources:
    """The owners. ``notices``: what is wrong with the records, for a page in its language and at a Unix time;
    ``history_fault``: why no history is stored. Both return an empty text while there is nothing to say."""

    guards: UnitGuards
    drift: GoldenDrift
    recipes: LoadedRecipes
    notices: Callable[[Translator, float], str]
    history_fault: Callable[[], str]
