"""What is shown of the line as a whole: the strip of what is abnormal, the verdict, the counts. Pure: it is
told how every unit was judged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from app.live.abnormal import LEVELS, Sight, Tally, Trouble, bus_trouble, verdict, worst
from app.live.age import figures_now
from app.live.fields import Fields, Voice, unit_key
from app.live.state import BusLive, LiveState
from app.web.formats import UNKNOWN

MOST_ENTRIES = 30
"""In the strip; when more is not well, the verdict has their number."""
NO_BREAK = "\u00a0"
Judged = Mapping[str, tuple[Sight, Trouble | None]]
"""How each unit looks and what is wrong with it, by the group of its fields."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One item of the strip of what is abnormal."""

    key: str
    name: str
    trouble: Trouble
    since: str = ""
    """``since 05:20``; empty where that is not known."""


def entries_of(live: LiveState, judged: Judged, voice: Voice, now: float) -> list[Entry]:
    """Everything that is not well, the worst first, in floor order; one cause is said once."""
    found: list[tuple[str, str, Trouble]] = []
    for name, bus in live.buses.items():
        trouble = bus_trouble(bus, voice, now) or _all_silent(name, bus, judged, voice)
        found += [(name, name, trouble)] if trouble is not None else _of_units(name, bus, judged)
    found.sort(key=lambda entry: LEVELS.index(entry[2].level))
    return [Entry(key, name, trouble, _since(trouble, voice, now)) for key, name, trouble in found]


def line_fields(live: LiveState, judged: Judged, entries: list[Entry], voice: Voice, now: float) -> Fields:
    """The fields of the whole line."""
    tally = Tally()
    for sight, _ in judged.values():
        tally.count(sight)
    return {
        "level": worst([entry.trouble for entry in entries]) or "",
        "verdict": verdict(tally, len(entries), voice),
        "heard": f"{tally.heard}",
        "at_speed": f"{tally.at_speed}",
        "at_zero": f"{tally.at_zero}",
        "ramping": f"{tally.ramping}",
        "off_speed": f"{tally.off_speed}",
        "lost": f"{tally.units - tally.heard}",
        "strip": "\n".join(
            "\t".join((entry.key, entry.trouble.level, entry.name, entry.trouble.text, entry.since))
            for entry in entries[:MOST_ENTRIES]
        ),
        "troubles": f"{len(entries)}",
        "named": _named(entries, judged, voice),
    } | _figures(live, voice, now)


def holders(held_by: Mapping[str, str], voice: Voice) -> str:
    """Who holds control of which bus, in words; ``held_by`` has an empty name for a bus that is free. Of the
    only bus there is, only the name is said, and nothing where nobody holds any. Breaks between two buses."""
    held = {bus: holder for bus, holder in held_by.items() if holder}
    if not held:
        return ""
    nobody, free = voice.t("nobody"), len(held_by) - len(held)
    if not free and len(set(held.values())) == 1:
        [holder] = set(held.values())
        return holder if len(held) == 1 else voice.t("{name}, every bus", name=holder)
    named = held if free > 1 else held_by
    said = [f"{bus}: {holder or nobody}" for bus, holder in named.items()]
    if free > 1:
        said.append(f"{voice.t('the others')}: {nobody}")
    return ", ".join(one.replace(" ", NO_BREAK) for one in said)


def _of_units(name: str, bus: BusLive, judged: Judged) -> list[tuple[str, str, Trouble]]:
    keys = (unit_key(name, number) for number in bus.units)
    seen = ((key, *judged[key]) for key in keys if key in judged)
    return [(key, sight.unit.settings.name, trouble) for key, sight, trouble in seen if trouble is not None]


def _all_silent(name: str, bus: BusLive, judged: Judged, voice: Voice) -> Trouble | None:
    """No unit of a whole bus answers."""
    units = [judged.get(unit_key(name, number), (None, None))[1] for number in bus.units]
    silent = [unit for unit in units if unit is not None and unit.code in ("offline", "unknown")]
    if len(units) < 2 or len(silent) < len(units):
        return None
    lost = [unit.since for unit in silent if unit.since is not None]
    if not lost:
        return Trouble("low", voice.t("no unit has answered yet"), "silent")
    return Trouble("urgent", voice.t("no unit answers"), "silent", max(lost))


def _since(trouble: Trouble, voice: Voice, now: float) -> str:
    if trouble.since is None:
        return ""
    return voice.t("since {time}", time=voice.formats.since(trouble.since, now))


def _named(entries: list[Entry], judged: Judged, voice: Voice) -> str:
    """What the pages without the strip name: each bus that is not well, and each block with its reason."""
    buses = [f"{entry.name}: {entry.trouble.text}" for entry in entries if "/" not in entry.key]
    sights = (sight for sight, _ in judged.values() if sight.blocked)
    blocks = [f"{sight.unit.settings.name} {voice.t('blocked')}: {sight.blocked}" for sight in sights]
    return " · ".join(buses + blocks)


def _figures(live: LiveState, voice: Voice, now: float) -> Fields:
    """The slowest scan and the fullest wire of all buses."""
    known = [figures for bus in live.buses.values() if (figures := figures_now(bus, now)) is not None]
    if not known:
        return {"scan": UNKNOWN, "wire": UNKNOWN}
    number = voice.formats.number
    return {
        "scan": f"{number(max(figures.scan_s for figures in known), 2)} s",
        "wire": f"{number(100 * max(figures.wire_utilisation for figures in known))} %",
    }
