"""The screen of one language: the fields of each unit, of each bus and of the line on its pages, and their
changes.

It stands between the live state and the sockets and does no I/O; the time is passed in. `Screen.render` is
for what a worker reported, `Screen.render_aged` once a second for what only time changes.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field
from decimal import Decimal
from math import ceil
from typing import NamedTuple

from app.core.web.formats import UNKNOWN
from app.line.conditions.catalogue import TILES, tile_text
from app.line.conditions.condition import PRIORITIES
from app.line.conditions.unit import DRAW_OUT_OF_BAND
from app.line.live.bus_live import (
    BusLive,
    LiveState,
    MotionState,
    UnitLive,
    both_run,
    draw_numbers,
    draw_of,
    figures_now,
    follower,
    speed_decimals,
    staged_units,
    unit_link_now,
)
from app.line.live.diagnosis import (
    Cause,
    Level,
    UnitView,
    are_alike,
    broken_rung,
    connection_cause,
    is_beside_running,
    no_response_cause,
    shown_cause,
    state_counts,
    timed_as_alarm,
    unit_cause,
)
from app.line.live.fields import (
    MEASURED,
    Fields,
    Groups,
    Translator,
    bus_fields,
    cause_texts,
    check_text,
    draw_fields,
    joined,
    merge_groups,
    name_on_site,
    put_fields,
    scan_text,
    unit_fields,
    unit_key,
)
from app.line.live.sources import AlarmDelay, ShelvedUntil, Sources, no_alarm, no_delay
from bus.instants import UnixTime
from bus.messages import NUMBER, Message, listed, term

LEVELS: tuple[Level, ...] = (*PRIORITIES, "")
NO_ALARM = term("no alarm: an input stopped it")
MAX_NAMES = 3
"""The most units that an input stopped and that are named beside the verdict; beyond it a number."""
NO_BREAK = "\u00a0"
_BREAK_AFTER = re.compile("([-/])")
"""After these a browser breaks a line, unless a word joiner follows."""
Views = Mapping[str, UnitView]
"""The presentation of each unit, by the group of its fields."""

STEADY: frozenset[MotionState] = frozenset({"at_speed", "at_zero", "stopped"})
FEW_MOVING = 8
"""The most moving units of which pages get each reading by itself, which takes a browser up to a third of a
core; the readings of more go together."""


class NamedCause(NamedTuple):
    """An abnormal cause, with the group and the name of its unit or bus."""

    key: str
    name: str
    cause: Cause

    @property
    def href(self) -> str:
        """The page of the unit or bus."""
        return f"/units/{self.key}" if "/" in self.key else f"/bus/{self.key}"


def abnormal_of(buses: Mapping[str, BusLive], views: Views, now: UnixTime) -> list[NamedCause]:
    """Return everything abnormal, the worst first, in floor order; each cause is named once."""
    found: list[NamedCause] = []
    for name, bus in buses.items():
        cause = no_response_cause(bus, now)
        if cause is not None:
            found.append(NamedCause(name, name, cause))
            continue
        for number in bus.units:
            view = views.get(key := unit_key(name, number))
            if view is not None and view.cause is not None and view.cause.level:
                found.append(NamedCause(key, name_on_site(name, view.unit.settings.name, buses), view.cause))
    found.sort(key=lambda each: LEVELS.index(each.cause.level))
    return found


def verdict_of(found: Sequence[NamedCause]) -> NamedCause | None:
    """Return the worst cause as the verdict, or None. A condition of low priority is no verdict on a line,
    which runs as well with it."""
    return found[0] if found and found[0].cause.level != "low" else None


def line_fields(
    buses: Mapping[str, BusLive],
    views: Views,
    found: Sequence[NamedCause],
    translator: Translator,
    now: UnixTime,
    alarmed: Set[str] = frozenset(),
    alarm_delay_s: AlarmDelay = no_delay,
    shelved_until: ShelvedUntil = no_alarm,
) -> Fields:
    """Return the fields of the line. ``found``: everything abnormal, the worst first; ``alarmed``: the units
    with an active alarm; ``alarm_delay_s``: when a condition becomes one; ``shelved_until``: until when its
    alarm is shelved. The verdict is the worst cause (``cause``), which begins with the number of other units
    of its line that have it, after the name of its unit (``name``), which a narrow page may drop; ``untimed``
    is the cause without its time, which the pages of units and alarms state beside the condition. ``beside``:
    what is ``named`` as well, for a line that breaks between two of them only."""
    counts = state_counts(views.values())
    abnormal = len(_abnormal_units(buses, found) | alarmed)
    worst, said = verdict_of(found), set[str]()
    if worst is not None:
        texts = cause_texts(worst.cause, translator, now)
        alike = [each for each in found if each is worst or _is_said_by(each, texts.line, translator, now)]
        said = {each.key for each in alike}
        others = sum(_is_like(worst, each) for each in found) - 1
        name, cause, untimed = _listed(alike, translator), f"· {texts.line}", f"· {texts.text}"
        if more := and_more(others, translator):
            cause, untimed = f"{more} {cause}", f"{more} {untimed}"
    else:
        name, cause = "", translator.t(all_well(len(views), counts, _running_at(buses)))
        untimed = cause
    named = [
        *_named(found, worst.key if worst else "", said, views, translator, now),
        *_not_yet(worst, alarm_delay_s, translator),
        *_shelved(found, worst.key if worst else "", shelved_until, translator, now),
    ]
    return {
        "level": worst.cause.level if worst else "",
        "verdict": f"{name} {cause}".lstrip(),
        "name": name,
        "cause": cause,
        "untimed": untimed,
        "at": worst.href if worst else "",
        "counts": translator.t(Message.of("line_abnormal", n=abnormal)) if abnormal else "",
        **{state: f"{counts[state]}" for state in ("online", "at_speed", "at_zero", "ramping", "off_speed")},
        "abnormal": f"{abnormal}",
        "staged": " | ".join(each.key for each in staged_units(buses.values(), now)),
        "named": " · ".join(named),
        "beside": " ".join(_whole(f"· {each}") for each in named),
    } | _figures(buses, translator, now)


def _whole(text: str) -> str:
    """Return a text in which no browser breaks a line."""
    return _BREAK_AFTER.sub("\\1\u2060", text.replace(" ", NO_BREAK))


def _is_like(worst: NamedCause, each: NamedCause) -> bool:
    """Return whether a cause is that of the verdict, of a unit of the same bus."""
    of_bus = [named.key.partition("/")[0] for named in (worst, each)]
    return each is worst or (of_bus[0] == of_bus[1] and are_alike(worst.cause, each.cause))


def and_more(others: int, translator: Translator) -> str:
    """Return how many ``others`` the verdict is about, after the name of its unit; empty without any."""
    return translator.t(Message.of("line_and_more", n=others)) if others > 0 else ""


def _is_said_by(named: NamedCause, line: str, translator: Translator, now: UnixTime) -> bool:
    """Return whether the line of the verdict is that of another bus, too."""
    return "/" not in named.key and cause_texts(named.cause, translator, now).line == line


def _listed(named: Iterable[NamedCause], translator: Translator) -> str:
    return ", ".join(translator.isolated(each.name) for each in named)


def _abnormal_units(buses: Mapping[str, BusLive], found: Iterable[NamedCause]) -> set[str]:
    """Return the units that are abnormal: of a bus that is the cause, all."""
    units: set[str] = set()
    for each in found:
        bus = buses.get(each.key)
        units |= {each.key} if bus is None else {unit_key(each.key, number) for number in bus.units}
    return units


def verdict_line(cause: Cause, translator: Translator, now: UnixTime) -> str:
    """Return a cause with its time as the verdict names it; with the reason if it is no alarm."""
    line = cause_texts(cause, translator, now).line
    return f"{line} · {translator.t(NO_ALARM)}" if cause.code == "run_off" else line


def _running_at(buses: Mapping[str, BusLive]) -> Message | None:
    """Return the speed of the only line: that of its first unit as commanded, such as ``120.0 m/min``; None
    if that is not known, or is a ratio to another unit, and for several lines, which may differ."""
    if len(buses) != 1:
        return None
    [bus] = buses.values()
    first = next(iter(bus.units.values()), None)
    if first is None or first.reading is None or follower(first):
        return None
    commanded, decimals = first.reading.commanded, speed_decimals(bus, first)
    if commanded is None or decimals is None:
        return None
    value = Message.of(NUMBER, value=f"{Decimal(commanded).scaleb(-decimals)}")
    measure = first.settings.labels.unit
    return Message.of("line_speed", value=value, unit=measure) if measure else value


def all_well(units: int, counts: Counter[str], speed: Message | None) -> Message:
    """Return the verdict while nothing is abnormal. ``speed``: that of the line."""
    if units == 0:
        return Message("line_no_units")
    if counts["at_zero"] == units:
        return Message.of("line_at_zero", n=units)
    if counts["ramping"]:
        return Message.of("line_ramping", n=counts["ramping"], units=units)
    if counts["at_speed"] == units:
        if speed is None:
            return Message.of("line_at_speed", n=units)
        return Message.of("line_running", n=units, speed=speed)
    if late := units - counts["online"]:
        return Message.of("line_partly_live", n=counts["at_speed"], units=units, late=late)
    at_speed = counts["at_speed"]
    return Message.of("line_partly_at_speed", n=at_speed, units=units, zero=units - at_speed)


def holders(held_by: Mapping[str, str], translator: Translator) -> str:
    """Return who holds control of which bus: for a single bus only the name, and an empty text if it is free.
    ``held_by``: the name by bus, empty for a bus that is free. Lines break between two buses."""
    held = {bus: holder for bus, holder in held_by.items() if holder}
    if not held:
        return ""
    no_one, free = translator.t("free"), len(held_by) - len(held)
    if not free and len(set(held.values())) == 1:
        [holder] = set(held.values())
        return holder if len(held) == 1 else translator.t(Message.of("control_of_every_bus", name=holder))
    named = held if free > 1 else held_by
    parts = [f"{bus}: {holder or no_one}" for bus, holder in named.items()]
    if free > 1:
        parts.append(f"{translator.t('the others')}: {no_one}")
    return ", ".join(one.replace(" ", NO_BREAK) for one in parts)


def _named(
    found: Sequence[NamedCause],
    worst: str,
    said: Set[str],
    views: Views,
    translator: Translator,
    now: UnixTime,
) -> list[str]:
    """Return the texts beside the verdict: each abnormal bus, abnormal conditions without an alarm, each
    block. ``worst``: the key of the unit or bus of the verdict; ``said``: those that it names."""
    buses = [
        f"{translator.isolated(name)}: {cause_texts(cause, translator, now).line}"
        for key, name, cause in found
        if "/" not in key and key not in said
    ]
    blocks = [
        f"{translator.isolated(view.unit.settings.name)} {translator.t('blocked')}: {view.blocked}"
        for key, view in views.items()
        if view.blocked and not (key == worst and view.cause and view.cause.code == "blocked")
    ]
    return [*buses, *_stopped_by_input(found, worst, translator), *blocks]


def _not_yet(worst: NamedCause | None, alarm_delay_s: AlarmDelay, translator: Translator) -> list[str]:
    """Return why the cause of the verdict is in no list of alarms yet."""
    delay_s = 0.0 if worst is None else alarm_delay_s(worst.key, TILES[worst.cause.code].code)
    return [translator.t(Message.of("line_alarm_follows", n=ceil(delay_s)))] if delay_s else []


def _stopped_by_input(found: Sequence[NamedCause], worst: str, translator: Translator) -> list[str]:
    """Return why units that an input stopped are in no list of alarms; without a name if the verdict names
    the only one."""
    stopped = [each for each in found if each.cause.code == "run_off"]
    if not stopped:
        return []
    if [each.key for each in stopped] == [worst]:
        return [translator.t(NO_ALARM)]
    many = translator.tn("{n} unit", "{n} units", len(stopped))
    names = _listed(stopped, translator) if len(stopped) <= MAX_NAMES else many
    return [f"{names}: {translator.t(NO_ALARM)}"]


def shelved_text(
    cause: Cause | None, place: str, shelved_until: ShelvedUntil, translator: Translator, now: UnixTime
) -> str:
    """Return until when the alarm of a cause is shelved; empty if it is not."""
    row = None if cause is None else TILES.get(cause.code)
    until = None if row is None else shelved_until(place, row.code)
    if until is None:
        return ""
    return translator.t(Message.of("cause_shelved", time=translator.formats.since(until, now)))


def _shelved(
    found: Sequence[NamedCause], worst: str, until: ShelvedUntil, translator: Translator, now: UnixTime
) -> list[str]:
    """Return which conditions are in no list of alarms because theirs is shelved; without a name that of the
    verdict."""
    named: dict[str, list[NamedCause]] = {}
    for each in found:
        if text := shelved_text(each.cause, each.key, until, translator, now):
            named.setdefault(text, []).append(each)
    return [
        text if [each.key for each in alike] == [worst] else f"{_listed(alike, translator)}: {text}"
        for text, alike in named.items()
    ]


def _figures(buses: Mapping[str, BusLive], translator: Translator, now: UnixTime) -> Fields:
    """Return the slowest scan and the fullest wire of all buses; unknown while those of one are."""
    known = [figures for bus in buses.values() if (figures := figures_now(bus, now)) is not None]
    if len(known) < max(len(buses), 1):
        return {"scan": UNKNOWN, "wire": UNKNOWN}
    number = translator.formats.number
    return {
        "scan": scan_text(translator, max(figures.scan_s for figures in known)),
        "wire": f"{number(100 * max(figures.wire_utilisation for figures in known))} %",
    }


LINE_GROUP = "line_summary"
"""The group of the totals: a name that no bus can have, as a slug has no underscore."""
ALARM_GROUP = "alarms_present"
_DECIDES = {"link", "state", "level", "cause", "staged", "mode", "alarm"}
"""Fields of a unit whose change may change the verdict and the totals of the line."""
MAX_DEPARTED = 3
"""The most units that differ from a recipe and are named; beyond it a number, and the page of recipes."""


def _is_active(mark: str) -> bool:
    """Return whether an alarm that is drawn so is active."""
    return bool(mark) and "cleared" not in mark


def _worn(alarm: Fields, level: Level, *, ramps: bool) -> Fields:
    """Return the mark of a unit on the line, whose words are beside it, and the ``priority`` of both. An
    alarm that is worse than the cause has both; if it is as bad, it has the mark, and of two of low priority
    the words; a lesser alarm has neither. Of a unit that ``ramps``, which explains its speed, an alarm of
    medium or low priority has the mark only."""
    mark = str(alarm.get("alarm", ""))
    place = LEVELS.index(mark.split()[0]) if _is_active(mark) else len(LEVELS)
    cause = LEVELS.index(level)
    is_said = place < cause or (place == cause and level == "low")
    if ramps and place >= LEVELS.index("medium"):
        is_said = False
    return {
        "worn": mark if place <= cause else "",
        "words": "alarm" if is_said else "",
        "priority": LEVELS[min(place, cause)],
    }


def _says_since(alarm: Fields, cause: Cause | None, bus: str, unit: int) -> bool:
    """Return whether the alarm of a unit is that of its cause and active: its text then has the time."""
    row = None if cause is None else TILES.get(cause.code)
    if row is None or not _is_active(str(alarm.get("alarm", ""))):
        return False
    return str(alarm.get("alarm_at", "")).startswith(f"/alarms/{bus}.{unit}.{row.code}.")


@dataclass(slots=True)
class Screen:
    """The present content of the pages in one language."""

    live: LiveState
    translator: Translator
    sources: Sources
    shown: Groups = field(default_factory=dict)
    _views: dict[str, UnitView] = field(default_factory=dict)
    _briefs: dict[str, tuple[str, str]] = field(default_factory=dict)
    """The brief text of each unit's tile, and since when, by unit."""
    _worst: str = ""
    """The unit of the verdict, which states since when; its tile does not."""

    def render(self, bus_name: str, units: Iterable[int], now: UnixTime, *, include_bus: bool) -> Groups:
        """Render the units of a report; return the changed fields."""
        bus = self.live.buses[bus_name]
        changed: Groups = {}
        for number in units:
            changed |= self.put(unit_key(bus_name, number), self._unit(bus_name, bus, bus.units[number], now))
        if include_bus:
            recipe = {"recipe": self._recipe(bus_name)}
            changed |= self.put(bus_name, bus_fields(bus, self.translator, now) | recipe)
        if include_bus or not all(_DECIDES.isdisjoint(fields) for fields in changed.values()):
            changed |= self.show_line(now)
            before, self._worst = self._worst, str(self.shown[LINE_GROUP]["at"]).removeprefix("/units/")
            for key in {before, self._worst} & self._briefs.keys():
                merge_groups(changed, self.put(key, {"brief": self._brief(key)}))
        return changed

    def _brief(self, key: str) -> str:
        what, since = self._briefs[key]
        return what if key == self._worst else f"{what} {since}".rstrip()

    def render_aged(self, now: UnixTime) -> Groups:
        """Render everything whose quality has changed by time alone."""
        changed: Groups = {}
        for name, bus in self.live.buses.items():
            aged = []
            for number, unit in bus.units.items():
                link = unit_link_now(bus, unit, now)
                if link == "stale" or self.shown.get(unit_key(name, number), {}).get("link") != link:
                    aged.append(number)
            merge_groups(changed, self.render(name, aged, now, include_bus=True))
        return changed

    def refresh(self, now: UnixTime) -> Groups:
        """Render everything. A server without a bus has totals too."""
        buses = self.live.buses.items()
        if not buses:
            return self.show_line(now)
        return merge_groups({}, *(self.render(name, bus.units, now, include_bus=True) for name, bus in buses))

    def put(self, group: str, fields: Fields) -> Groups:
        """Set fields of a group; return those that changed."""
        return put_fields(self.shown, group, fields)

    def may_wait(self, groups: Groups) -> bool:
        """Return whether a change may go together with later ones: it has only new measurements, of steady
        units or while many move."""
        if not groups or any(fields.keys() - MEASURED for fields in groups.values()):
            return False
        is_steady = all(self.shown[group].get("state") in STEADY for group in groups)
        return is_steady or self._moving() > FEW_MOVING

    def _moving(self) -> int:
        """Return the number of units online that are not steady."""
        views = self._views.values()
        return sum(view.unit.motion.state not in STEADY and view.link == "online" for view in views)

    def flat(self) -> Fields:
        """Return everything shown, by ``group.field``, for the first paint of a page."""
        return {
            f"{group}.{name}": value for group, fields in self.shown.items() for name, value in fields.items()
        }

    def _unit(self, bus_name: str, bus: BusLive, unit: UnitLive, now: UnixTime) -> Fields:
        number = unit.settings.id
        block = self.sources.guards[bus_name].block_reason(number)
        blocked = self.translator.t(block) if block is not None else ""
        drifted = self.sources.drift[bus_name].summary(number, self.translator, now)
        key = unit_key(bus_name, number)
        ladder = timed_as_alarm(unit_cause(bus, unit, now), key, self.sources.alarm_since)
        cause = shown_cause(bus, unit, ladder, now, blocked=block, drifted=drifted.words)
        if cause is not ladder:
            cause = timed_as_alarm(cause, key, self.sources.alarm_since)
        ramps = ladder is not None and ladder.code == "ramping"
        view = UnitView(unit, unit_link_now(bus, unit, now), cause, blocked)
        self._views[key] = view
        fields = unit_fields(bus, unit, view.link, self.translator)
        texts = cause_texts(cause, self.translator, now) if cause is not None else None
        alarm = self.sources.unit_alarm(bus_name, number, self.translator, now)
        status = moves = joined(fields["state_text"])
        check, self._briefs[key] = check_text(cause, self.translator), (moves, "")
        draw = draw_of(bus, unit, now)
        if cause is not None and cause.code == DRAW_OUT_OF_BAND.code:
            numbers = draw_numbers(bus, unit, draw)
            check = " · ".join([*([self.translator.t(numbers)] if numbers else []), check])
        if texts is not None:
            self._briefs[key] = texts.brief, texts.since
            is_said = _says_since(alarm, cause, bus_name, number)
            if not is_beside_running(cause):
                status = texts.text if is_said else texts.line
            else:
                # It runs: what is beside that is its alarm, or has the line below.
                check = check or ("" if is_said else texts.line)
                if ladder is not None and ladder is not cause:
                    status = cause_texts(ladder, self.translator, now).line
                    if ramps:
                        self._briefs[key] = status, ""
        shelved = shelved_text(cause, key, self.sources.shelved_until, self.translator, now)
        if is_beside_running(cause):
            check = " · ".join(filter(None, (check, shelved)))
        else:
            status = " · ".join(filter(None, (status, shelved)))
        fields |= draw_fields(draw, self.translator, both_run=both_run(bus, unit))
        of_bus = connection_cause(bus, now)
        # Abnormal once, at its bus; its own page has the mark of that cause. What is beside running has none.
        page_level = of_bus.level if of_bus and cause and of_bus.code == cause.code else view.level
        silent = tile_text(of_bus.code if of_bus else "unit_offline") if view.link != "online" else None
        return fields | {
            "level": view.level,
            "silent": self.translator.t(silent) if silent else "",
            "page_level": "" if is_beside_running(cause) else page_level,
            "cause": texts.line if texts is not None and view.level else "",
            "status": status,
            "brief": self._brief(key),
            "check": check,
            "rung": broken_rung(ladder),
            "blocked": blocked,
            "drift": drifted.key,
            **alarm,
            **_worn(alarm, view.level, ramps=ramps),
        }

    def _recipe(self, bus_name: str) -> str:
        loaded = self.sources.recipes[bus_name]()
        if loaded is None:
            return ""
        name, departed = loaded
        if not departed:
            return name
        if len(departed) > MAX_DEPARTED:
            message = Message.of("recipe_with_drift_of_many", name=name, n=len(departed))
        else:
            message = Message.of("recipe_with_drift", name=name, units=listed(departed))
        return self.translator.t(message)

    def show_line(self, now: UnixTime) -> Groups:
        """Render the totals; return those that changed."""
        buses, views = self.live.buses, self._views
        alarmed = {key for key in views if _is_active(str(self.shown[key].get("alarm", "")))}
        found = abnormal_of(buses, views, now)
        delay_s, shelved = self.sources.alarm_delay_s, self.sources.shelved_until
        line = line_fields(buses, views, found, self.translator, now, alarmed, delay_s, shelved)
        return self.put(LINE_GROUP, line)
