"""Finds what a request or form names (sets, rows, restores, files), or refuses it with a Problem."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Form, UploadFile

from app.core.web.admission.bounds import MAX_BODY_BYTES, parse_apart
from app.core.web.services import service
from app.engineering.sets.document import MAX_DOCUMENT, THE_FILE, read_document
from app.engineering.sets.model import ParameterSet, UnitRows
from app.engineering.sets.restore.record import Restore
from app.engineering.sets.restore.restores import RestoreService
from app.engineering.sets.store import SetStore
from app.errors import Problem, or_404
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
    """One side of a comparison: ``text`` as :mod:`app.engineering.sets.comparison.sides` names it,
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
