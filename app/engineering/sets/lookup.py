"""Searches for the sets, rows, restores and files that a request or form names; a fault raises Problem.

A text names a side of a comparison in addresses and forms: ``set:12:3`` is unit 3 of set 12,
``golden:dry-end:3`` the golden set of unit 3, ``live:dry-end:3`` its values as last read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Form, UploadFile

from app.core.web.request_rules import MAX_BODY_BYTES, parse_apart
from app.core.web.services import service
from app.core.web.shape import parse_integer
from app.engineering.sets.model import ParameterSet, ParameterSetSummary, UnitRows, known_rows
from app.engineering.sets.restore_plan import Restore
from app.engineering.sets.restore_service import RestoreService
from app.engineering.sets.store import MAX_DOCUMENT, THE_FILE, SetStore, read_document
from app.errors import Problem, or_404
from app.line.live.bus_live import LiveState
from app.line.live.requests import unit_or_404
from bus.instants import UnixTime
from bus.messages import Message

Sets = Annotated[SetStore, service(SetStore)]
Restores = Annotated[RestoreService, service(RestoreService)]


async def document_rows(
    text: str, source: str | Message, unit: int, from_unit: int | None = None
) -> UnitRows:
    """Read a unit's rows from a TOML file: those of ``from_unit`` if given, its own, or the only ones.

    Raise DocumentError, or Problem 422 if the file has no such unit.
    """
    document = await parse_apart(lambda: read_document(text, source))
    lone = document.units[0] if len(document.units) == 1 and from_unit is None else None
    rows = document.unit(from_unit or unit) or lone
    if rows is None:
        raise Problem(422, "invalid", Message.of("source_lacks_unit", source=source, unit=from_unit or unit))
    return rows


async def set_or_404(sets: Sets, set_id: int) -> ParameterSet:
    return or_404(await sets.load(set_id), "unknown_set", Message.of("no_such_set", set=set_id))


StoredSet = Annotated[ParameterSet, Depends(set_or_404)]
"""The set with the ``{set_id}`` of the path."""


def unit_rows_or_404(stored: ParameterSet, unit: int) -> UnitRows:
    """Return the rows of one unit of a set. Raise Problem 404 if it has none."""
    lacks = Message.of("set_lacks_unit", set=stored.id, unit=unit)
    return or_404(stored.unit(unit), "unknown_unit", lacks)


async def restore_or_404(restores: Restores, restore_id: str) -> Restore:
    """Return a begun restore, or a plan made since the server started. Raise Problem 404."""
    return or_404(await restores.find(restore_id), "unknown_restore", Message("no_such_restore"))


KnownRestore = Annotated[Restore, Depends(restore_or_404)]
"""The restore with the ``{restore_id}`` of the path."""


@dataclass(frozen=True, slots=True)
class FormSource:
    """The source that a form names: the ``text`` of a side, or an uploaded ``file``."""

    text: str
    file: UploadFile | None

    async def uploaded(self, unit: int) -> UnitRows | None:
        """Read the file's rows for ``unit``; None without a file. Raise DocumentError or Problem 422."""
        if self.file is None:
            return None
        name = self.file.filename or THE_FILE
        content = await self.file.read(MAX_DOCUMENT + 1)
        if len(content) > MAX_DOCUMENT:
            raise Problem(422, "invalid", Message.of("source_too_long", source=name))
        try:
            return await document_rows(content.decode("utf-8-sig"), name, unit)
        except UnicodeDecodeError as error:
            wrong = Message.of("source_not_utf8", source=name, why=error.reason, n=error.start)
            raise Problem(422, "invalid", wrong) from error


async def form_source(source: Annotated[str, Form()] = "", file: UploadFile | None = None) -> FormSource:
    """Read the form. A browser sends an empty file field as a file without a name."""
    return FormSource(source, file if file is not None and file.filename else None)


Chosen = Annotated[FormSource, Depends(form_source)]
FILE_FORM: dict[str, Any] = {
    "max_body_size": MAX_BODY_BYTES,
    "form_limits": {"max_files": 1, "max_fields": 100},
}
"""The options of a route whose form has room for one file."""


@dataclass(frozen=True, slots=True)
class Side:
    """A side of a comparison. ``kind``: set, golden or live; ``source``: the set's number, or the bus."""

    kind: str
    source: str
    unit: int
    rows: UnitRows


@dataclass(frozen=True, slots=True)
class SideOption:
    """A side that a person can choose by its ``text``.

    ``name`` and ``group`` are those of the section, empty and None if the unit is not configured. For a live
    unit ``taken_at`` is None, and ``title`` and ``origin`` are empty.
    """

    text: str
    bus: str
    unit: int
    name: str
    group: str | None
    taken_at: UnixTime | None = None
    title: str = ""
    golden: bool = False
    origin: str = ""


def choices(live: LiveState, sets: Sequence[ParameterSetSummary]) -> list[SideOption]:
    """List every unit as last read, then every unit of each stored set, newest set first."""
    units = {
        (bus, unit): one.settings for bus, line in live.buses.items() for unit, one in line.units.items()
    }
    found = [
        SideOption(f"live:{bus}:{unit}", bus, unit, settings.name, settings.group)
        for (bus, unit), settings in units.items()
    ]
    for one in sets:
        for unit in one.units:
            known = units.get((one.bus, unit))
            place = (one.bus, unit, known.name if known else "", known.group if known else None)
            taken = (one.taken_at, one.name, unit in one.golden_for, one.origin)
            found.append(SideOption(f"set:{one.id}:{unit}", *place, *taken))
    return found


async def side(text: str, store: SetStore, live: LiveState) -> Side:
    """Find the side that ``text`` names. Raise Problem 404 or 422."""
    kind, _, rest = text.partition(":")
    source, _, number = rest.rpartition(":")
    unit = parse_integer(number)
    if kind not in ("set", "golden", "live") or not source or unit is None:
        known = "set:12:3, golden:BUS:3 or live:BUS:3"
        raise Problem(422, "invalid", Message.of("no_such_side", text=text, known=known))
    return Side(kind, source, unit, await _rows(kind, source, unit, store, live))


async def _rows(kind: str, source: str, unit: int, store: SetStore, live: LiveState) -> UnitRows:
    if kind == "set":
        number = parse_integer(source)
        if number is None:
            raise Problem(422, "invalid", Message.of("not_a_set_number", text=source))
        return unit_rows_or_404(await set_or_404(store, number), unit)
    if kind == "live":
        return known_rows(unit_or_404(live, source, unit))
    golden = (await store.golden(source)).get(unit)
    return or_404(golden, "unknown_set", Message.of("no_golden_set", unit=unit, bus=source))


@dataclass(frozen=True, slots=True)
class Offers:
    """The sides from which a unit can be restored.

    ``own``: the unit's sets, newest first; ``sisters``: the newest and the golden set of every other unit,
    the units of the same group first; ``neighbours``: the other units as they are now.
    """

    own: list[SideOption]
    sisters: list[SideOption]
    neighbours: list[SideOption]

    @property
    def golden(self) -> str:
        """The golden set of the unit; empty if it has none."""
        return next((choice.text for choice in self.own if choice.golden), "")

    @property
    def best(self) -> str:
        """The golden set of the unit, else its newest set; empty if it has none."""
        return self.golden or next((choice.text for choice in self.own), "")


def offers(live: LiveState, sets: Sequence[ParameterSetSummary], bus: str, unit: int) -> Offers:
    """Return the sides from which ``unit`` can be restored; ``sets``: newest first."""
    group = live.buses[bus].units[unit].settings.group
    every = choices(live, sets)
    own = [one for one in every if one.taken_at is not None and (one.bus, one.unit) == (bus, unit)]
    others = [one for one in every if (one.bus, one.unit) != (bus, unit)]
    others.sort(key=lambda one: (one.bus != bus, one.group != group))
    sisters: list[SideOption] = []
    seen: set[tuple[str, int]] = set()
    for one in others:
        if one.taken_at is not None and (one.golden or (one.bus, one.unit) not in seen):
            sisters.append(one)
            seen.add((one.bus, one.unit))
    return Offers(own, sisters, [one for one in others if one.taken_at is None])
