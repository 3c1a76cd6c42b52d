"""What a form names as the source of a unit's new values: a stored set, or an uploaded file in its place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from fastapi import APIRouter, Depends, Form, UploadFile

from app.sets.lookup import uploaded_rows
from app.sets.model import UnitRows
from app.web.bounds import MOST_BODY_BYTES

Endpoint = TypeVar("Endpoint", bound=Callable[..., Any])


@dataclass(frozen=True, slots=True)
class FormSource:
    """``text``: a side, as :mod:`app.sets.sides` names it. ``file`` None: none was uploaded."""

    text: str
    file: UploadFile | None

    @property
    def file_name(self) -> str:
        """As the browser named the file; empty without one."""
        return (self.file.filename or "") if self.file is not None else ""

    async def uploaded(self, unit: int) -> UnitRows | None:
        """The rows of the file for ``unit``, None without one. Raises Problem 422."""
        return None if self.file is None else await uploaded_rows(unit, self.file)


async def form_source(source: Annotated[str, Form()] = "", file: UploadFile | None = None) -> FormSource:
    """Reads the form. A browser sends a file field that was left empty without a name."""
    return FormSource(source, file if file is not None and file.filename else None)


Chosen = Annotated[FormSource, Depends(form_source)]


def post_source(router: APIRouter, path: str) -> Callable[[Endpoint], Endpoint]:
    """Decorates the endpoint that takes such a form, with room for one file."""
    return router.post(path, max_body_size=MOST_BODY_BYTES, form_limits={"max_files": 1, "max_fields": 100})
