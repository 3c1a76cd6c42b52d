"""What is shown of the line as a whole: the verdict, the strip of what is abnormal, the counts. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from app.live.diagnosis.abnormal import LEVELS, StateCounts, UnitView, all_offline
from app.live.diagnosis.cause import Cause, bus_cause
from app.live.diagnosis.rungs import Level
from app.live.screen.cause_text import cause_line, cause_text, since_text
from app.live.screen.fields import Fields, Translator, scan_text, unit_key
from app.live.state.age import figures_now
from app.live.state.live_state import LiveState
from app.web.formats import UNKNOWN
from bus.instants import UnixTime

MOST_ENTRIES = 30
"""In the strip; when more is not well, the verdict has their number."""
NO_BREAK = "\u00a0"
Views = Mapping[str, UnitView]
"""How each unit looks, by the group of its fields."""


@dataclass(frozen=True, slots=True)
class AbnormalItem:
    """One item of the strip of what is abnormal. ``key``: the group of its unit or bus."""

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


def entries_of(live: LiveState, views: Views, voice: Translator, now: UnixTime) -> list[AbnormalItem]:
    """Everything abnormal, the worst first, in floor order; one cause is named once."""
    found: list[tuple[str, str, Cause]] = []
    for name, bus in live.buses.items():
        of_bus = [(key, views[key]) for number in bus.units if (key := unit_key(name, number)) in views]
        cause = bus_cause(bus, now) or all_offline([view for _, view in of_bus])
        if cause is not None:
            found.append((name, name, cause))
        else:
            found += [
                (key, view.unit.settings.name, view.cause)
                for key, view in of_bus
                if view.cause and view.level
            ]
    found.sort(key=lambda entry: LEVELS.index(entry[2].level))
    return [
        AbnormalItem(
            key,
            name,
            cause.level,
            cause_text(cause, voice),
            since_text(cause, voice, now),
            cause_line(cause, voice, now),
        )
        for key, name, cause in found
    ]


def strip_of(entries: list[AbnormalItem]) -> list[AbnormalItem]:
    """What stands beside the verdict, which names the worst."""
    return entries[1 : 1 + MOST_ENTRIES]


def line_fields(
    live: LiveState, views: Views, entries: list[AbnormalItem], voice: Translator, now: UnixTime
) -> Fields:
    """The fields of the whole line. The verdict is the worst cause, after the name of its unit."""
    tally = StateCounts()
    for view in views.values():
        tally.count(view)
    worst = entries[0] if entries else None
    return {
        "level": worst.level if worst else "",
        "verdict": f"{worst.name} · {worst.line}" if worst else _all_well(tally, voice),
        "at": worst.href if worst else "",
        "counts": voice.t("{n} abnormal", n=len(entries)) if worst else "",
        "online": f"{tally.online}",
        "at_speed": f"{tally.at_speed}",
        "at_zero": f"{tally.at_zero}",
        "ramping": f"{tally.ramping}",
        "off_speed": f"{tally.off_speed}",
        "strip": "\n".join(
            "\t".join((entry.key, entry.level, entry.name, entry.text, entry.since))
            for entry in strip_of(entries)
        ),
        "abnormal": f"{len(entries)}",
        "named": _named(entries, views, voice),
    } | _figures(live, voice, now)


def _all_well(tally: StateCounts, voice: Translator) -> str:
    """The line in one sentence while nothing is abnormal."""
    if tally.units == 0:
        return voice.t("No unit is configured")
    if tally.at_zero == tally.units:
        return voice.tn("{n} unit at zero", "All {n} units at zero", tally.units)
    if tally.ramping:
        return voice.t("{n} of {units} ramping", n=tally.ramping, units=tally.units)
    if tally.at_speed == tally.units:
        return voice.tn("{n} unit at speed", "All {n} units at speed", tally.units)
    return voice.t("{n} of {units} at speed, the others at zero", n=tally.at_speed, units=tally.units)


def holders(held_by: Mapping[str, str], voice: Translator) -> str:
    """Who holds control of which bus, in words; ``held_by`` has an empty name for a bus that is free. Of the
    only bus there is, only the name is said, and nothing where nobody holds any. Breaks between two buses."""
    held = {bus: holder for bus, holder in held_by.items() if holder}
    if not held:
        return ""
    nobody, free = voice.t("free"), len(held_by) - len(held)
    if not free and len(set(held.values())) == 1:
        [holder] = set(held.values())
        return holder if len(held) == 1 else voice.t("{name}, every bus", name=holder)
    named = held if free > 1 else held_by
    said = [f"{bus}: {holder or nobody}" for bus, holder in named.items()]
    if free > 1:
        said.append(f"{voice.t('the others')}: {nobody}")
    return ", ".join(one.replace(" ", NO_BREAK) for one in said)


def _named(entries: list[AbnormalItem], views: Views, voice: Translator) -> str:
    """What the pages without the strip name beside the verdict: each bus that is abnormal, each block."""
    worst = entries[0].key if entries else ""
    buses = [f"{entry.name}: {entry.line}" for entry in entries[1:] if "/" not in entry.key]
    blocks = [
        f"{view.unit.settings.name} {voice.t('blocked')}: {view.blocked}"
        for key, view in views.items()
        if view.blocked and not (key == worst and view.cause and view.cause.code == "blocked")
    ]
    return " · ".join(buses + blocks)


def _figures(live: LiveState, voice: Translator, now: UnixTime) -> Fields:
    """The slowest scan and the fullest wire of all buses."""
    known = [figures for bus in live.buses.values() if (figures := figures_now(bus, now)) is not None]
    if not known:
        return {"scan": UNKNOWN, "wire": UNKNOWN}
    number = voice.formats.number
    return {
        "scan": scan_text(voice, max(figures.scan_s for figures in known)),
        "wire": f"{number(100 * max(figures.wire_utilisation for figures in known))} %",
    }
