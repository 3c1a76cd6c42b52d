"""The line on one page: the verdict, the strip of abnormal units, the counts. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from app.core.web.rendering.formats import UNKNOWN
from app.line.conditions.priority import PRIORITIES
from app.line.live.diagnosis.abnormal import UnitView, all_offline, state_counts
from app.line.live.diagnosis.cause import Cause, Level, bus_cause
from app.line.live.screen.cause_text import cause_texts
from app.line.live.screen.fields import Fields, Translator, name_on_site, scan_text, unit_key
from app.line.live.state.age import figures_now
from app.line.live.state.bus_live import BusLive
from bus.instants import UnixTime
from bus.messages import Message

LEVELS: tuple[Level, ...] = (*PRIORITIES, "")
MAX_ENTRIES = 30
"""In the strip; with more abnormal ones, the verdict has their number."""
NO_BREAK = "\u00a0"
Views = Mapping[str, UnitView]
"""How each unit looks, by the group of its fields."""


@dataclass(frozen=True, slots=True)
class AbnormalItem:
    """One item of the strip. ``key``: the group of its unit or bus."""

    key: str
    name: str
    level: Level
    text: str
    since: str
    """``since 05:20``; empty where that is not known."""
    line: str
    """Both in one."""

    @property
    def href(self) -> str:
        """The page of its unit or bus."""
        return f"/units/{self.key}" if "/" in self.key else f"/bus/{self.key}"


class NamedCause(NamedTuple):
    """A cause that is abnormal, with the group and the name of its unit or bus; it has no texts yet."""

    key: str
    name: str
    cause: Cause


def abnormal_of(buses: Mapping[str, BusLive], views: Views, now: UnixTime) -> list[NamedCause]:
    """Everything abnormal, the worst first, in floor order; one cause is named once."""
    found: list[NamedCause] = []
    for name, bus in buses.items():
        cause = bus_cause(bus, now) or all_offline(bus, now)
        if cause is not None:
            found.append(NamedCause(name, name, cause))
            continue
        for number in bus.units:
            view = views.get(key := unit_key(name, number))
            if view is not None and view.cause is not None and view.cause.level:
                found.append(NamedCause(key, name_on_site(name, view.unit.settings.name, buses), view.cause))
    found.sort(key=lambda each: LEVELS.index(each.cause.level))
    return found


def entries_of(found: Sequence[NamedCause], translator: Translator, now: UnixTime) -> list[AbnormalItem]:
    """The worst of what was found, for the verdict, and those that the strip has room for: no page
    shows the texts of the others."""
    return [
        AbnormalItem(key, name, cause.level, *cause_texts(cause, translator, now))
        for key, name, cause in found[: 1 + MAX_ENTRIES]
    ]


def strip_of(entries: list[AbnormalItem]) -> list[AbnormalItem]:
    """The items beside the verdict, which names the worst."""
    return entries[1:]


def line_fields(
    buses: Mapping[str, BusLive],
    views: Views,
    found: Sequence[NamedCause],
    entries: list[AbnormalItem],
    translator: Translator,
    now: UnixTime,
) -> Fields:
    """The fields of the line; ``entries``: of what was ``found``. The verdict is the worst cause, after the
    name of its unit: ``cause`` after ``name``."""
    counts = state_counts(views.values())
    worst = entries[0] if entries else None
    name, cause = (
        (f"{translator.isolated(worst.name)} ·", worst.line)
        if worst
        else ("", translator.t(all_well(len(views), counts)))
    )
    return {
        "level": worst.level if worst else "",
        "verdict": f"{name} {cause}".strip(),
        "name": name,
        "cause": cause,
        "at": worst.href if worst else "",
        "counts": translator.t(Message.of("line_abnormal", n=len(found))) if worst else "",
        **{state: f"{counts[state]}" for state in ("online", "at_speed", "at_zero", "ramping", "off_speed")},
        "strip": [
            [entry.key, entry.level, entry.name, entry.text, entry.since] for entry in strip_of(entries)
        ],
        "abnormal": f"{len(found)}",
        "named": _named(found, views, translator, now),
    } | _figures(buses, translator, now)


def all_well(units: int, counts: Counter[str]) -> Message:
    """The verdict while nothing is abnormal."""
    if units == 0:
        return Message("line_no_units")
    if counts["at_zero"] == units:
        return Message.of("line_at_zero", n=units)
    if counts["ramping"]:
        return Message.of("line_ramping", n=counts["ramping"], units=units)
    if counts["at_speed"] == units:
        return Message.of("line_at_speed", n=units)
    return Message.of("line_partly_at_speed", n=counts["at_speed"], units=units)


def holders(held_by: Mapping[str, str], translator: Translator) -> str:
    """Who holds control of which bus; ``held_by`` has an empty name for a bus that is free. For
    a single bus only the name, and an empty text where it is free. Breaks between two buses."""
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


def _named(found: Sequence[NamedCause], views: Views, translator: Translator, now: UnixTime) -> str:
    """What the pages without the strip name beside the verdict: each bus that is abnormal, each block."""
    worst = found[0].key if found else ""
    buses = [
        f"{translator.isolated(name)}: {cause_texts(cause, translator, now).line}"
        for key, name, cause in found[1:]
        if "/" not in key
    ]
    blocks = [
        f"{translator.isolated(view.unit.settings.name)} {translator.t('blocked')}: {view.blocked}"
        for key, view in views.items()
        if view.blocked and not (key == worst and view.cause and view.cause.code == "blocked")
    ]
    return " · ".join(buses + blocks)


def _figures(buses: Mapping[str, BusLive], translator: Translator, now: UnixTime) -> Fields:
    """The slowest scan and the fullest wire of all buses."""
    known = [figures for bus in buses.values() if (figures := figures_now(bus, now)) is not None]
    if not known:
        return {"scan": UNKNOWN, "wire": UNKNOWN}
    number = translator.formats.number
    return {
        "scan": scan_text(translator, max(figures.scan_s for figures in known)),
        "wire": f"{number(100 * max(figures.wire_utilisation for figures in known))} %",
    }
