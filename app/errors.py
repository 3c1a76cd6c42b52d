"""What can go wrong in the app, each as a sentence that says what to do."""

from __future__ import annotations

from typing import Any

from bus.errors import LinesideError


class StoreError(LinesideError):
    """A store cannot be opened, read or written."""


class DamagedStoreError(StoreError):
    """SQLite found pages of an open store damaged."""


class Problem(LinesideError):
    """A refusal that goes to whoever asked: problem+json for programs, a page or a fragment for people.

    ``code`` is the machine's word for it, ``detail`` the sentence; ``extra`` are further members of the
    answer (RFC 9457, 3.2).
    """

    def __init__(self, status: int, code: str, detail: str, **extra: Any) -> None:
        super().__init__(detail)
        self.status = status
        self.code = code
        self.detail = detail
        self.extra = extra
        self.headers: dict[str, str] = {}

    def with_headers(self, **headers: str) -> Problem:
        """The same refusal with response headers; an underscore in a name stands for a hyphen."""
        self.headers.update({name.replace("_", "-"): value for name, value in headers.items()})
        return self
