"""The line as it stands on the browsers' pages in one language: what is shown, and what changed.

Between the live state and the sockets: no I/O and no clock. Order of use: :meth:`Screen.see` for what
a worker reported, :meth:`Screen.settle` once a second for what only time changes; both give the
fields that are different now.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

from app.live.abnormal import (
    LEVELS,
    Sight,
    Tally,
    Trouble,
    bus_trouble,
    conditions_of,
    unit_trouble,
    verdict,
    worst,
)
from app.live.age import scan_s_of, stale_after_s, unit_link_now
from app.live.fields import Fields, Voice, bits_of, bus_fields, unit_fields, unit_key
from app.live.motion import Motion
from app.live.state import BusLive, LiveState, UnitLive
from app.web.formats import UNKNOWN

Groups = dict[str, Fields]
WHOLE_LINE = "whole_line"
"""The group of the totals: a name that no bus can have (a slug holds no underscore)."""
MOST_ENTRIES = 30
"""In the strip; when more is not well, the verdict has their number."""
_DECIDES = {"link", "state", "level", "trouble"}
"""A change of these in a unit may change the strip and the totals of the line."""
_OF_THE_LINK = {"unknown", "offline", "stale"}
"""Said of the bus, and not of each of its units again, while the bus itself is in trouble."""
Block = Callable[[str, int], str]
"""The reason why a unit is blocked, by bus and address; empty where it is not."""
Drift = Callable[[str, int], int]
"""In how many parameters a unit departs from its golden set, by bus and address."""
Recipe = Callable[[str], tuple[str, int] | None]
"""The recipe that a bus was loaded with, and how many units have departed from it since."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One item of the strip of what is abnormal."""

    key: str
    name: str
    trouble: Trouble
    since: str = ""
    """``since 05:20``; empty where that is not known."""


@dataclass(slots=True)
class Screen:
    """What the pages in one language show now."""

    live: LiveState
    voice: Voice
    motions: dict[tuple[str, int], Motion]
    block: Block
    drift: Drift
    recipe: Recipe
    shown: Groups = field(default_factory=dict)
    entries: list[Entry] = field(default_factory=list)
    _judged: dict[str, tuple[Sight, Trouble | None]] = field(default_factory=dict)

    def see(self, bus_name: str, units: Iterable[int], now: float, *, whole_bus: bool) -> Groups:
        """Render what a report touched; gives what is different now."""
        bus = self.live.buses[bus_name]
        changed: Groups = {}
        for number in units:
            self._put(changed, unit_key(bus_name, number), self._unit(bus_name, bus, bus.units[number], now))
        if whole_bus:
            fields = bus_fields(bus, self.voice) | {"recipe": self._recipe(bus_name)}
            self._put(changed, bus_name, fields)
        if whole_bus or any(_DECIDES & fields.keys() for fields in changed.values()):
            self._put(changed, WHOLE_LINE, self._line(now))
        return changed

    def settle(self, now: float) -> Groups:
        """Render everything whose quality has changed by time alone."""
        changed: Groups = {}
        for name, bus in self.live.buses.items():
            aged = [
                number
                for number, unit in bus.units.items()
                if self.shown.get(unit_key(name, number), {}).get("link") != unit_link_now(bus, unit, now)
                or unit_link_now(bus, unit, now) == "stale"
            ]
            for group, fields in self.see(name, aged, now, whole_bus=True).items():
                changed.setdefault(group, {}).update(fields)
        return changed

    def refresh(self, now: float) -> Groups:
        """Render everything anew."""
        changed: Groups = {}
        for name, bus in self.live.buses.items():
            for group, fields in self.see(name, bus.units, now, whole_bus=True).items():
                changed.setdefault(group, {}).update(fields)
        return changed

    def put(self, group: str, fields: Fields) -> Groups:
        """Show something that is no unit and no bus; gives what is different now."""
        changed: Groups = {}
        self._put(changed, group, fields)
        return changed

    def flat(self) -> Fields:
        """Everything shown, by ``group.field``, for the first paint of a page."""
        return {
            f"{group}.{name}": text for group, fields in self.shown.items() for name, text in fields.items()
        }

    def _put(self, changed: Groups, group: str, fields: Fields) -> None:
        before = self.shown.get(group, {})
        different = {name: text for name, text in fields.items() if before.get(name) != text}
        if different:
            self.shown[group] = {**before, **fields}
            changed.setdefault(group, {}).update(different)

    def _unit(self, bus_name: str, bus: BusLive, unit: UnitLive, now: float) -> Fields:
        number = unit.settings.id
        motion, blocked = self.motions[bus_name, number], self.block(bus_name, number)
        link, overdue = unit_link_now(bus, unit, now), _is_overdue(bus, unit, now)
        drifted = self.drift(bus_name, number)
        sight = Sight(unit, link, motion.state, blocked, overdue, drifted, motion.since)
        trouble = unit_trouble(bus, sight, self.voice)
        if trouble is not None and trouble.code in _OF_THE_LINK and bus_trouble(bus, self.voice):
            trouble = None
        self._judged[unit_key(bus_name, number)] = (sight, trouble)
        return unit_fields(bus, unit, sight.link, sight.state, self.voice) | {
            "level": trouble.level if trouble else "",
            "trouble": trouble.text if trouble else "",
            "blocked": blocked,
        }

    def _recipe(self, bus_name: str) -> str:
        loaded = self.recipe(bus_name)
        if loaded is None:
            return ""
        name, departed = loaded
        if not departed:
            return name
        text = "{name}, {n} unit departed" if departed == 1 else "{name}, {n} units departed"
        return self.voice.t(text, name=name, n=departed)

    def _line(self, now: float) -> Fields:
        tally, self.entries = Tally(), []
        for name, bus in self.live.buses.items():
            trouble = bus_trouble(bus, self.voice) or self._all_silent(name, bus)
            if trouble is not None:
                self.entries.append(Entry(name, name, trouble, self._since(trouble, now)))
            for number in bus.units:
                self._take(unit_key(name, number), tally, now, silent=trouble is not None)
        self.entries.sort(key=lambda entry: LEVELS.index(entry.trouble.level))
        return self._totals(tally) | self._figures()

    def _all_silent(self, name: str, bus: BusLive) -> Trouble | None:
        """One cause, said once: no unit of a whole bus answers."""
        units = [self._judged.get(unit_key(name, number), (None, None))[1] for number in bus.units]
        silent = [unit for unit in units if unit is not None and unit.code in ("offline", "unknown")]
        if len(units) < 2 or len(silent) < len(units):
            return None
        lost = [unit.since for unit in silent if unit.since is not None]
        if not lost:
            return Trouble("low", self.voice.t("no unit has answered yet"), "silent")
        return Trouble("urgent", self.voice.t("no unit answers"), "silent", max(lost))

    def _take(self, key: str, tally: Tally, now: float, *, silent: bool) -> None:
        if key not in self._judged:
            return
        sight, trouble = self._judged[key]
        tally.count(sight)
        if trouble is not None and not silent:
            name = sight.unit.settings.name
            self.entries.append(Entry(key, name, trouble, self._since(trouble, now)))

    def _since(self, trouble: Trouble, now: float) -> str:
        if trouble.since is None:
            return ""
        return self.voice.t("since {time}", time=self.voice.formats.since(trouble.since, now))

    def _totals(self, tally: Tally) -> Fields:
        level = worst([entry.trouble for entry in self.entries])
        return {
            "level": level or "",
            "verdict": verdict(tally, len(self.entries), self.voice),
            "heard": f"{tally.heard}",
            "at_speed": f"{tally.at_speed}",
            "at_zero": f"{tally.at_zero}",
            "ramping": f"{tally.ramping}",
            "off_speed": f"{tally.off_speed}",
            "lost": f"{tally.units - tally.heard}",
            "strip": "\n".join(
                "\t".join((entry.key, entry.trouble.level, entry.name, entry.trouble.text, entry.since))
                for entry in self.entries[:MOST_ENTRIES]
            ),
            "troubles": f"{len(self.entries)}",
            "blocked": self._blocked(),
        }

    def _blocked(self) -> str:
        """Every block with its reason, for the pages without the strip."""
        sights = (sight for sight, _ in self._judged.values() if sight.blocked)
        return " · ".join(f"{sight.unit.settings.name}: {sight.blocked}" for sight in sights)

    def _figures(self) -> Fields:
        """The slowest scan and the fullest wire of all buses."""
        open_figures = [
            bus.figures
            for bus in self.live.buses.values()
            if bus.figures is not None and bus.link.link == "open"
        ]
        if not open_figures:
            return {"scan": UNKNOWN, "wire": UNKNOWN}
        number = self.voice.formats.number
        return {
            "scan": f"{number(max(figures.scan_s for figures in open_figures), 2)} s",
            "wire": f"{number(100 * max(figures.wire_utilisation for figures in open_figures))} %",
        }


def _is_overdue(bus: BusLive, unit: UnitLive, now: float) -> bool:
    return unit.reading is None or now - unit.reading.at > stale_after_s(scan_s_of(bus))


def motions_for(live: LiveState) -> dict[tuple[str, int], Motion]:
    """One motion for each unit, shared by all languages."""
    return {(name, number): Motion() for name, bus in live.buses.items() for number in bus.units}


def watch_motions(
    motions: dict[tuple[str, int], Motion], bus_name: str, bus: BusLive, units: Sequence[int], scan_s: float
) -> None:
    """Let the motions see the newest readings of these units."""
    for number in units:
        reading = bus.units[number].reading
        if reading is not None:
            bits, motion = bits_of(bus, reading), motions[bus_name, number]
            state = motion.see(reading, at_speed=bits.at_speed, scan_s=scan_s)
            motion.note(reading.at, conditions_of(bits, reading, state))
