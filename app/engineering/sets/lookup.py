"""Finds what a request or form names (sets, rows, restores, files), or refuses it with a Problem.

The two sides of a comparison as an address can name them, and those that a unit can be restored from.

``set:12:3`` is unit 3 of set 12, ``golden:dry-end:3`` the golden set of unit 3, ``live:dry-end:3`` its values
as last read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Form, UploadFile

from app.core.web.admission.bounds import MAX_BODY_BYTES, parse_apart
from app.core.web.api.shape import parse_integer
from app.core.web.services import service
from app.engineering.sets.document import MAX_DOCUMENT, THE_FILE, read_document
from app.engineering.sets.model import ParameterSet, ParameterSetSummary, UnitRows, known_rows
from app.engineering.sets.restore_plan import Restore
from app.engineering.sets.restore_service import RestoreService
from app.engineering.sets.store import SetStore
from app.errors import Problem, or_404
from app.line.live.bus_live import LiveState
from app.line.live.requests import unit_or_404
from bus.instants import UnixTime
from bus.messages import Message, term

Sets = Annotated[SetStore, service(SetStore)]
Restores = Annotated[RestoreService, service(RestoreService)]


async def wanted_rows(
    store: SetStore, unit: int, set_id: int | None, document_text: str | None, from_unit: int | None
) -> UnitRows:
    """What the unit shall become. Raises Problem 422 or 404 in words."""
    if (set_id is None) == (document_text is None):
        raise Problem(422, "invalid", Message("set_or_document"))
    if set_id is not None:
        return unit_rows_or_404(await set_or_404(store, set_id), from_unit or unit)
    return await document_rows(document_text or "", term("the document"), unit, from_unit)


async def document_rows(
    text: str, source: str | Message, unit: int, from_unit: int | None = None
) -> UnitRows:
    """The rows of a TOML file meant for a unit: of ``from_unit`` where given, its own, or the only ones.

    Raises DocumentError, or Problem 422 where the file has no such unit.
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
"""The set of ``{set_id}`` in the path."""


def unit_rows_or_404(stored: ParameterSet, unit: int) -> UnitRows:
    """The rows of one unit of a set."""
    lacks = Message.of("set_lacks_unit", set=stored.id, unit=unit)
    return or_404(stored.unit(unit), "unknown_unit", lacks)


async def restore_or_404(restores: Restores, restore_id: str) -> Restore:
    """A restore that was begun, or a plan of this run of the server."""
    return or_404(await restores.find(restore_id), "unknown_restore", Message("no_such_restore"))


KnownRestore = Annotated[Restore, Depends(restore_or_404)]
"""The restore of ``{restore_id}`` in the path."""


@dataclass(frozen=True, slots=True)
class FormSource:
    """One side of a comparison: ``text`` as :mod:`app.engineering.sets.lookup` names it,
    ``file`` None if none was uploaded."""

    text: str
    file: UploadFile | None

    async def uploaded(self, unit: int) -> UnitRows | None:
        """The rows of the file for ``unit``, None without one. Raises DocumentError or Problem 422."""
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
    """Reads the form. A browser sends a file field that was left empty without a name."""
    return FormSource(source, file if file is not None and file.filename else None)


Chosen = Annotated[FormSource, Depends(form_source)]


FILE_FORM: dict[str, Any] = {
    "max_body_size": MAX_BODY_BYTES,
    "form_limits": {"max_files": 1, "max_fields": 100},
}
"""Options of the route of such a form: room for one file."""


@dataclass(frozen=True, slots=True)
class Side:
    """One side. ``kind``: set, golden or live; ``of``: the set's number or the bus."""

    kind: str
    of: str
    unit: int
    rows: UnitRows


@dataclass(frozen=True, slots=True)
class SideOption:
    """A side that can be chosen: ``text`` as an address names it, ``name`` and ``group`` of its section,
    empty and None where it is not configured. What a stored set has is None or empty of the live unit."""

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
    """Every unit as last read, then every unit of every stored set, newest first."""
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
    """Find what ``text`` names. Raises Problem 404 or 422 in words."""
    kind, _, rest = text.partition(":")
    of, _, number = rest.rpartition(":")
    unit = parse_integer(number)
    if kind not in ("set", "golden", "live") or not of or unit is None:
        known = "set:12:3, golden:BUS:3 or live:BUS:3"
        raise Problem(422, "invalid", Message.of("no_such_side", text=text, known=known))
    return Side(kind, of, unit, await _rows(kind, of, unit, store, live))


async def _rows(kind: str, of: str, unit: int, store: SetStore, live: LiveState) -> UnitRows:
    if kind == "set":
        number = parse_integer(of)
        if number is None:
            raise Problem(422, "invalid", Message.of("not_a_set_number", text=of))
        return unit_rows_or_404(await set_or_404(store, number), unit)
    if kind == "live":
        return known_rows(unit_or_404(live, of, unit))
    golden = (await store.golden(of)).get(unit)
    return or_404(golden, "unknown_set", Message.of("no_golden_set", unit=unit, bus=of))


@dataclass(frozen=True, slots=True)
class Offers:
    """``own``: sets of the unit, newest first; ``sisters``: the newest and the golden set of every other
    unit, those of the same group first; ``neighbours``: the other units as they are now."""

    own: list[SideOption]
    sisters: list[SideOption]
    neighbours: list[SideOption]

    @property
    def golden(self) -> str:
        """The golden set of the unit; empty where it has none."""
        return next((choice.text for choice in self.own if choice.golden), "")

    @property
    def best(self) -> str:
        """The reference of the unit: its golden set, else its newest; empty where it has none."""
        return self.golden or next((choice.text for choice in self.own), "")


def offers(live: LiveState, sets: Sequence[ParameterSetSummary], bus: str, unit: int) -> Offers:
    """Everything that helps ``unit``; ``sets`` newest first."""
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
