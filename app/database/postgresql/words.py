"""Turns failures of PostgreSQL into messages for people."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from psycopg import DataError, Error, InterfaceError, OperationalError, errors

from app.errors import ConstraintError, StoreError, StoreUnavailableError, TooCostlyError
from bus.errors import CallerError, LinesideError
from bus.messages import Message


@contextmanager
def in_words(name: str) -> Iterator[None]:
    """Turn what the driver raises into an error that names the store.

    ConstraintError for a broken rule of a table, TooCostlyError for a read that took too long, CallerError
    for a value that can only come from a request, StoreUnavailableError where the database may come back.
    """
    try:
        yield
    except Error as error:
        raise _meaning(name, error) from error


def _meaning(name: str, error: Error) -> LinesideError:
    """By its class: the text of the server may be of any language."""
    match error:
        case errors.IntegrityError():
            return ConstraintError(Message.of("store_rule_broken", path=name, error=_text(error)))
        case errors.QueryCanceled():
            return TooCostlyError(Message("search_too_costly"))
        case errors.NumericValueOutOfRange():
            return CallerError(Message("number_too_large"))
        case DataError(sqlstate=None):
            # The driver itself refuses what the protocol cannot carry.
            return CallerError(Message("text_with_nul"))
    kind, reason = _failure(error)
    return kind(Message.of("store_failed", path=name, reason=reason))


def _failure(error: Error) -> tuple[type[StoreError], Message]:
    match error:
        case errors.ReadOnlySqlTransaction():
            return StoreUnavailableError, Message("store_is_standby")
        case errors.InsufficientPrivilege():
            return StoreError, Message.of("store_lacks_rights", error=_text(error))
        case errors.DiskFull():
            return StoreError, Message("store_disk_full")
        case errors.DeadlockDetected() | errors.SerializationFailure() | errors.LockNotAvailable():
            return StoreUnavailableError, Message("store_busy")
        case OperationalError(pgconn=lost) if lost and (lost.needs_password or lost.used_password):
            return StoreUnavailableError, Message.of("store_sign_in_refused", error=_text(error))
        case OperationalError() | InterfaceError() | errors.IdleInTransactionSessionTimeout():
            return StoreUnavailableError, Message.of("store_unreachable", error=_text(error))
    return StoreError, Message.of("store_statement_failed", error=_text(error))


def _text(error: Error) -> str:
    """The first line: the others quote the statement, or hint at what a person at the database could do."""
    return str(error.diag.message_primary or error).strip().split("\n")[0]
