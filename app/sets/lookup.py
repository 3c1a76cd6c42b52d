"""What a request names, found or refused in words."""

from __future__ import annotations

from fastapi import UploadFile

from app.errors import Problem
from app.sets.document import LONGEST_DOCUMENT, TOO_LONG, DocumentError, read_document
from app.sets.keeper import SetKeeper
from app.sets.model import ParameterSet, UnitRows
from app.sets.restore import RestoreDesk
from app.sets.restore_record import Restore
from app.web.parsing import parse_apart

NOT_UTF_8 = "{source} is no text in UTF-8: {why} at byte {n}; save it as UTF-8"


async def wanted_rows(
    keeper: SetKeeper, unit: int, set_id: int | None, document_text: str | None, from_unit: int | None
) -> UnitRows:
    """What the unit shall become. Raises Problem 422 or 404 in words."""
    if (set_id is None) == (document_text is None):
        raise Problem(422, "invalid", "give either set (a stored one) or document (a TOML file)")
    if set_id is not None:
        return unit_rows_or_404(await set_or_404(keeper, set_id), from_unit or unit)
    return await document_rows(document_text or "", "the document", unit, from_unit)


async def document_rows(text: str, source: str, unit: int, from_unit: int | None = None) -> UnitRows:
    """The rows of a TOML file meant for a unit: of ``from_unit`` where given, its own, or the only ones.

    Raises Problem 422 in words.
    """
    try:
        document = await parse_apart(lambda: read_document(text, source))
    except DocumentError as error:
        raise Problem(422, "invalid", error.template, params=error.params) from error
    lone = document.units[0] if len(document.units) == 1 and from_unit is None else None
    rows = document.unit(from_unit or unit) or lone
    if rows is None:
        params = {"source": source, "unit": from_unit or unit}
        raise Problem(422, "invalid", "{source} does not hold unit {unit}", params=params)
    return rows


async def uploaded_rows(unit: int, file: UploadFile) -> UnitRows:
    """The rows of an uploaded TOML file. Raises Problem 422 in words."""
    name = file.filename or "the file"
    content = await file.read(LONGEST_DOCUMENT + 1)
    if len(content) > LONGEST_DOCUMENT:
        raise Problem(422, "invalid", TOO_LONG, params={"source": name})
    try:
        return await document_rows(content.decode("utf-8-sig"), name, unit)
    except UnicodeDecodeError as error:
        params = {"source": name, "why": error.reason, "n": error.start}
        raise Problem(422, "invalid", NOT_UTF_8, params=params) from error


async def set_or_404(keeper: SetKeeper, set_id: int) -> ParameterSet:
    """A stored set."""
    stored = await keeper.store.load(set_id)
    if stored is None:
        raise Problem(404, "unknown_set", f"there is no parameter set {set_id}")
    return stored


def unit_rows_or_404(stored: ParameterSet, unit: int) -> UnitRows:
    """The rows of one unit of a set."""
    rows = stored.unit(unit)
    if rows is None:
        raise Problem(404, "unknown_unit", f"set {stored.id} does not hold unit {unit}")
    return rows


async def restore_or_404(restores: RestoreDesk, restore_id: str) -> Restore:
    """A restore that was begun, or a plan of this run of the server."""
    restore = await restores.find(restore_id)
    if restore is None:
        why = "no such restore; a plan that was not begun ends with the server: plan again"
        raise Problem(404, "unknown_restore", why)
    return restore
