"""What can go wrong in the app, each as a sentence that says what to do."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal, get_args

from bus.errors import CallerError, LinesideError

ProblemCode = Literal[
    "acknowledged",
    "already_started",
    "blocked",
    "bus_closed",
    "busy",
    "cancelled",
    "confirm_needed",
    "controlled",
    "dangerous",
    "failed",
    "forbidden",
    "foreign_origin",
    "invalid",
    "lapsed",
    "late",
    "method_not_allowed",
    "moved",
    "no_parquet",
    "no_set",
    "not_found",
    "not_loadable",
    "not_looked",
    "not_sent",
    "nothing_staged",
    "refused",
    "rights_withdrawn",
    "store",
    "too_large",
    "too_long",
    "too_many",
    "unauthorized",
    "unknown",
    "unknown_bus",
    "unknown_output",
    "unknown_parameter",
    "unknown_recipe",
    "unknown_restore",
    "unknown_set",
    "unknown_swap",
    "unknown_taking",
    "unknown_unit",
    "unverified",
    "verified",
]
"""Every ``code`` of a problem and every ``outcome`` of a command: published in the API's OpenAPI document."""
CODES: frozenset[str] = frozenset(get_args(ProblemCode))


class StoreError(LinesideError):
    """A store cannot be opened, read or written."""


class DamagedStoreError(StoreError):
    """SQLite found pages of an open store damaged."""


class Problem(LinesideError):
    """A refusal that goes to the client: problem+json for programs, a page or a fragment for people.

    ``code`` is the reason for programs. ``detail`` says it in English; with ``params`` it is a template
    whose ``{names}`` they fill in. Request text belongs in ``params``: the template is looked up in the
    catalog of the reader's language, where request text must never go. ``extra`` are members of the answer
    (RFC 9457, 3.2).
    """

    def __init__(
        self,
        status: int,
        code: ProblemCode,
        detail: str,
        *,
        params: Mapping[str, object] | None = None,
        **extra: Any,
    ) -> None:
        self.template = detail
        self.params = params
        self.detail = detail if params is None else detail.format(**params)
        super().__init__(self.detail)
        self.status = status
        self.code = code
        self.extra = extra
        self.headers: dict[str, str] = {}

    def text(self, t: Callable[..., str]) -> str:
        """The detail in the language whose translation function is ``t``."""
        return t(self.template) if self.params is None else t(self.template, **self.params)

    def with_headers(self, **headers: str) -> Problem:
        """The same refusal with response headers; an underscore in a name stands for a hyphen."""
        self.headers.update({name.replace("_", "-"): value for name, value in headers.items()})
        return self


class InvalidError(Problem, CallerError):
    """422 ``invalid``: what was asked cannot be done as asked. On the command line: exit code 2."""

    def __init__(self, detail: str, **params: object) -> None:
        super().__init__(422, "invalid", detail, params=params)
