"""The sources of what pages and the API show of a line beside its workers' reports: features add theirs
here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, Protocol

from app.core.web.access import account_shown
from app.core.web.formats import Formats
from app.line.live.fields import Fields, Translator
from bus.instants import Monotonic, UnixTime
from bus.messages import Message


class Drifted(NamedTuple):
    """The parameters in which a unit departs from its golden set and who changed them: ``words`` for the
    line, and a ``key`` that changes whenever the list on the unit's page does. Both are empty without a
    departure."""

    words: str = ""
    key: str = ""


class HeldControl(Protocol):
    """The control of a bus by an account. ``used_at``: monotonic time of its last command."""

    @property
    def holder(self) -> str: ...
    @property
    def used_at(self) -> Monotonic: ...


@dataclass(frozen=True, slots=True)
class BusControl:
    """The control of a bus as every page shows it. ``holder``: an account, empty if control is free.
    ``since``, ``lapses_at`` and ``request_until``: Unix time in seconds. ``request``: the state of the
    request of ``requester``, empty if there is none."""

    bus: str
    holder: str = ""
    since: UnixTime = UnixTime(0.0)
    lapses_at: UnixTime = UnixTime(0.0)
    requester: str = ""
    request: Literal["", "pending", "declined", "lapsed"] = ""
    request_until: UnixTime = UnixTime(0.0)

    @property
    def holder_shown(self) -> str | Message:
        """The holder, in the reader's language if it is a program."""
        return account_shown(self.holder)

    @property
    def requester_shown(self) -> str | Message:
        """The requester of control, in the reader's language if it is a program."""
        return account_shown(self.requester)

    @property
    def key(self) -> str:
        """A text that changes with the shown control; the time left is not in it."""
        return "\n".join((self.bus, self.holder, f"{self.since:.3f}", self.requester, self.request))


class UnitGuards(Protocol):
    """The blocked units of a bus, and the holder of its control."""

    def block_reason(self, unit: int) -> Message | None:
        """Return why commands to a unit are blocked and by whom; None if they are not."""

    def holding(self) -> HeldControl | None:
        """Return who holds control of the bus; None if it is free."""

    def bus_control(self) -> BusControl:
        """Return who controls the bus, and who requests that."""


class GoldenDrift(Protocol):
    """The differences of the units of a bus from their golden sets."""

    def is_drifted(self, unit: int) -> bool | None:
        """Return whether a unit differs; None while that is not known."""

    def golden_values(self, unit: int) -> Mapping[int, Message]:
        """Return the value in the golden set for each parameter that differs, by number."""

    def summary(self, unit: int, translator: Translator, now: UnixTime) -> Drifted:
        """Return the differences of a unit in the reader's language. ``now``: Unix time in seconds."""


class LineFields(Protocol):
    """The lines, those of other servers too, as fields in the reader's language."""

    def shown(self, translator: Translator) -> dict[str, Fields]:
        """Return the fields of each line, by its group."""

    def changes(self, translator: Translator) -> dict[str, Fields]:
        """Return the fields that differ from the last call for this language."""

    def forget(self, tag: str) -> None:
        """Forget the fields that pages in a language have, because none follows the lines in it."""


AlarmBanner = Callable[[Translator], Fields]
"""A function that returns the mark of the first alarm and the counts of all in the reader's language."""
UnitAlarm = Callable[[str, int, Translator, UnixTime], Fields]
"""A function that returns the first alarm of a unit in the reader's language, all empty without one:
``alarm``, its priority, whether it has cleared and whether it waits for an acknowledgement; ``alarm_text``,
its name; ``alarm_said``, name and priority; ``alarm_state``, its state with the time that matters;
``alarm_more``, the number of others; ``alarm_at``, its page."""
AlarmDelay = Callable[[str, str], float]
"""A function that returns after how many seconds a condition, by its code, of a unit (``dry-end/4``) or bus
becomes an alarm; 0 if it is one, or something hides it."""
AlarmSince = Callable[[str, str], UnixTime | None]
"""A function that returns since when a condition of a unit or bus is an active alarm; None if it is none."""
ShelvedUntil = Callable[[str, str], UnixTime | None]
"""A function that returns until when the alarm of such a condition is shelved; None if it is not."""
LoadedRecipe = Callable[[], tuple[str, list[str | Message]] | None]
"""A function that returns the recipe a bus loaded last and the units that differ from it since, if any."""
Notice = Callable[[Formats, UnixTime], Message | None]
"""A function that returns the fault of a record that the server keeps, at a Unix time; None without one."""


def no_delay(_place: str, _code: str) -> float:
    """Return 0: no condition becomes an alarm later."""
    return 0.0


def no_alarm(_place: str, _code: str) -> UnixTime | None:
    """Return None: no condition is an alarm."""
    return None


@dataclass(slots=True)
class Sources:
    """The sources by bus, and those of the site. ``observe_age``: lets the alarms observe what time alone has
    changed; ``history_fault``: why no history is stored, None while it is."""

    guards: dict[str, UnitGuards] = field(default_factory=dict)
    drift: dict[str, GoldenDrift] = field(default_factory=dict)
    recipes: dict[str, LoadedRecipe] = field(default_factory=dict)
    banner: AlarmBanner = lambda *_: {}
    unit_alarm: UnitAlarm = lambda *_: {}
    alarm_delay_s: AlarmDelay = no_delay
    alarm_since: AlarmSince = no_alarm
    shelved_until: ShelvedUntil = no_alarm
    observe_age: Callable[[], None] = lambda: None
    notices: list[Notice] = field(default_factory=list)
    history_fault: Callable[[], Message | None] = lambda: None

    def show_alarms(
        self,
        banner: AlarmBanner,
        unit_alarm: UnitAlarm,
        delay_s: AlarmDelay,
        since: AlarmSince,
        shelved_until: ShelvedUntil,
        observe_age: Callable[[], None],
    ) -> None:
        """Show the alarms that these functions return, from now on."""
        self.banner, self.unit_alarm, self.observe_age = banner, unit_alarm, observe_age
        self.alarm_delay_s, self.alarm_since, self.shelved_until = delay_s, since, shelved_until

    def notice(self, translator: Translator, now: UnixTime) -> str:
        """Return the faults of the server's records in the reader's language; mostly empty."""
        found = (notice(translator.formats, now) for notice in self.notices)
        return " ".join(translator.t(each) for each in found if each is not None)
