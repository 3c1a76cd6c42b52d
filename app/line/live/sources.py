"""Data on pages and in the API that no worker reports, by owner."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from app.core.web.rendering.head_control import BusControl
from app.line.live.fields import Fields, Translator
from bus.instants import UnixTime
from bus.messages import Message

UnitSubscriber = Callable[[int], None]
"""Called with the address of a unit of a bus of which something changed."""

AlarmChangeSubscriber = Callable[[str | None, int | None], None]
"""Called with the bus and the unit of an alarm; None: of the site, or of the bus."""


class Drifted(NamedTuple):
    """In which parameters a unit departs from its golden set and who did that: ``words`` for the line, and a
    ``key`` that is another whenever the list on the unit's page is. Both empty where nothing is golden."""

    words: str = ""
    key: str = ""


class UnitGuards(Protocol):
    """Which units of a bus are blocked, and who controls it."""

    def block_reason(self, unit: int) -> Message | None:
        """Why commands to a unit are blocked and by whom; None when they are not."""

    def bus_control(self) -> BusControl:
        """Who controls the bus, and who requests that."""

    def on_control(self, subscriber: Callable[[], None]) -> None:
        """Call ``subscriber`` when control has another holder, or was requested."""

    def on_block(self, subscriber: UnitSubscriber) -> None:
        """Call ``subscriber`` when a unit was blocked or released."""


class GoldenDrift(Protocol):
    """How the units of a bus differ from their golden sets."""

    def summary(self, unit: int, translator: Translator, now: UnixTime) -> Drifted:
        """The differences of a unit in the reader's language. ``now``: Unix time in seconds."""

    def on_change(self, subscriber: UnitSubscriber) -> None:
        """Call ``subscriber`` when the differences of a unit have changed."""


class AlarmMarks(Protocol):
    """What the pages show of the alarms."""

    def banner(self, translator: Translator, now: UnixTime) -> Fields:
        """The first alarm with its state, in the reader's language. ``now``: Unix time in seconds."""

    def of_unit(self, bus: str, unit: int, translator: Translator, now: UnixTime) -> Fields:
        """The first alarm of a unit in the reader's language, all empty without one: ``alarm``, its priority,
        whether it has cleared and whether it waits for an acknowledgement; ``alarm_text``, its name;
        ``alarm_state``, its state with the time that matters; ``alarm_more``, how many more there are;
        ``alarm_at``, its page."""

    def on_change(self, subscriber: AlarmChangeSubscriber) -> None:
        """Call ``subscriber`` when an alarm has changed."""


class LoadedRecipes(Protocol):
    """Which recipe each bus runs."""

    def loaded_words(self, bus: str) -> tuple[str, list[str | Message]] | None:
        """The recipe loaded last and the names of the units that differ from it since; None without one."""


class LineFields(Protocol):
    """All lines as fields in the reader's language."""

    def shown(self, translator: Translator) -> dict[str, Fields]:
        """Those of each line now, by its group."""

    def changes(self, translator: Translator) -> dict[str, Fields]:
        """Those that differ from the last call for this language."""

    def forget(self, tag: str) -> None:
        """No page in this language follows them."""


@dataclass(frozen=True, slots=True)
class Sources:
    """The owners, those of a bus by its name. ``notices``: faults of the records, for a page in its
    language and at a Unix time; empty where there is none; ``history_fault``: why no history
    is stored, None while it is."""

    guards: Mapping[str, UnitGuards]
    drift: Mapping[str, GoldenDrift]
    recipes: LoadedRecipes
    alarms: AlarmMarks
    lines: LineFields
    notices: Callable[[Translator, UnixTime], str]
    history_fault: Callable[[], Message | None]
