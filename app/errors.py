"""The errors of the app, each with a text that states what to do."""

from __future__ import annotations

import ssl
from collections.abc import Iterator
from typing import Any, Literal, TypeVar, get_args

from bus.errors import LinesideError
from bus.messages import Message

ProblemCode = Literal[
    "acknowledged",
    "already_signed",
    "already_started",
    "below_a_path",
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
    "malformed",
    "method_not_allowed",
    "moved",
    "no_parquet",
    "no_set",
    "not_found",
    "not_in_state",
    "not_loadable",
    "not_looked",
    "not_sent",
    "not_signed",
    "nothing_staged",
    "refused",
    "rights_withdrawn",
    "same_person",
    "store",
    "superseded",
    "taken",
    "too_costly",
    "too_large",
    "too_long",
    "too_many",
    "unauthorized",
    "unknown",
    "unknown_alarm",
    "unknown_bus",
    "unknown_note",
    "unknown_output",
    "unknown_parameter",
    "unknown_recipe",
    "unknown_restore",
    "unknown_set",
    "unknown_shift",
    "unknown_swap",
    "unknown_taking",
    "unknown_unit",
    "unsupported_type",
    "unverified",
    "upgrade_required",
    "verified",
    "wrong_host",
]
"""Every ``code`` of a problem and every ``outcome`` of a command: published in the API's OpenAPI document."""
T = TypeVar("T")
CODES: frozenset[str] = frozenset(get_args(ProblemCode))


class StoreError(LinesideError):
    """Raised when a store cannot be opened, read or written."""


class DamagedStoreError(StoreError):
    """Raised when SQLite cannot follow the pages of a store, or finds no store in its file."""


class TooCostlyError(StoreError):
    """Raised when a read took longer than it may and was ended."""


class ConstraintError(LinesideError):
    """Raised when a rule of a table refuses a row: the key exists, or the row never changes. Nothing was
    stored."""


def system_error(error: Exception) -> Message:
    """Return the operating system's text for a failure."""
    return Message.of("system_error", error=getattr(error, "strerror", None) or str(error))


class Problem(LinesideError):
    """A refusal that goes to the client: problem+json for programs, a page or a fragment for people.

    ``code`` is the kind of reason for programs, ``message`` the reason, ``detail`` its text in English.
    ``extra`` are members of the response (RFC 9457, 3.2); one of them may also be called ``message``.
    """

    def __init__(self, status: int, code: ProblemCode, message: Message, /, **extra: Any) -> None:
        super().__init__(message)
        self.detail = str(self)
        self.status = status
        self.code = code
        self.extra = extra
        self.headers: dict[str, str] = {}

    def with_headers(self, **headers: str) -> Problem:
        """Return the same refusal with response headers; an underscore in a name becomes a hyphen."""
        self.headers.update({name.replace("_", "-"): value for name, value in headers.items()})
        return self


def or_404(found: T | None, code: ProblemCode, message: Message) -> T:
    """Return ``found``, which a request names. Raise Problem 404 if it is None."""
    if found is None:
        raise Problem(404, code, message)
    return found


def network_cause(error: BaseException) -> str:
    """Return the text of the operating system or of TLS below an error of a library, whose own may hold the
    URL."""
    for found in _causes(error):
        if isinstance(found, ssl.SSLCertVerificationError):
            return found.verify_message
        if isinstance(found, OSError) and found.strerror:
            return found.strerror
    return type(error).__name__


def is_refused_certificate(error: BaseException) -> bool:
    """Return whether the certificate of the other end was refused."""
    return any(isinstance(found, ssl.SSLCertVerificationError) for found in _causes(error))


def _causes(error: BaseException) -> Iterator[BaseException]:
    found: BaseException | None = error
    while found is not None:
        yield found
        found = found.__cause__ or found.__context__
