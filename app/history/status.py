"""The state of the history itself, for pages and the API."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from app.web.api.shape import InstantObject, MessageObject
from app.web.rendering.formats import Formats
from bus.instants import UnixTime
from bus.messages import Message

StoreState = Literal["ok", "low", "scarce", "paused", "failed"]


@dataclass(frozen=True, slots=True)
class HistoryStatus:
    """State of the history. ``low``: the disk is nearly full; ``scarce``: the oldest readings go."""

    __pydantic_config__ = ConfigDict(json_schema_serialization_defaults_required=True)

    state: Annotated[
        StoreState,
        Field(description="low, scarce: little disk space; paused, failed: nothing is stored."),
    ] = "ok"
    message: Annotated[MessageObject | None, Field(description="What to do; null: nothing.")] = None
    cause: Annotated[
        MessageObject | None, Field(description="Why the store cannot be used; null: it can.")
    ] = None
    since: Annotated[InstantObject, Field(description="Since when.")] = UnixTime(0.0)
    size_bytes: int = 0
    free_bytes: Annotated[int, Field(description="Free space on the disk.")] = 0
    oldest_reading: Annotated[InstantObject | None, Field(description="null: none is stored.")] = None
    waiting: Annotated[int, Field(description="Updates that are not on disk yet.")] = 0
    lost: Annotated[int, Field(description="Updates that could not be stored.")] = 0
    damaged: Annotated[int, Field(description="Damages found in the last seven days.")] = 0
    put_aside: Annotated[
        str, Field(description="File of the damaged history, of the last seven days; empty: there is none.")
    ] = ""
    begun: Annotated[
        InstantObject | None, Field(description="When history began again; null: none was damaged.")
    ] = None


NOTICES: dict[StoreState, Message] = {
    "low": Message("history_disk_low"),
    "scarce": Message("history_disk_scarce"),
    "paused": Message("history_disk_full"),
    "failed": Message("history_failed"),
}
DAMAGED = Message("history_damaged")


def damage_message(status: HistoryStatus, shown: Callable[[UnixTime], str]) -> Message | None:
    """Message about history that is not shown because it was damaged; ``shown`` writes a time as text."""
    if status.begun is not None:
        return Message.of("history_put_aside", time=shown(status.begun), file=status.put_aside)
    return DAMAGED if status.damaged else None


def store_message(state: StoreState, cause: Message | None = None) -> Message | None:
    """How the store is; None while it is well."""
    if state == "ok" or cause is None:
        return NOTICES.get(state)
    return Message.of("history_because", notice=NOTICES[state], cause=cause)


def store_notice(status: HistoryStatus, formats: Formats, now: UnixTime) -> Message | None:
    """The notice on the pages; None while history is stored."""
    since = formats.since(status.since, now)
    match status.state:
        case "ok":
            return damage_message(status, lambda at: formats.since(at, now))
        case "failed":
            return Message.of("history_failed_since", time=since, reason=status.cause or NOTICES["failed"])
        case "paused":
            return Message.of("history_paused_since", time=since)
        case _:
            return Message.of("history_notice", notice=NOTICES[status.state])
