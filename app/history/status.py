"""The state of the history itself, for pages and the API."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from app.web.formats import Formats
from bus.instants import UnixTime
from bus.messages import Message

StoreState = Literal["ok", "low", "scarce", "paused", "failed"]


@dataclass(frozen=True, slots=True)
class Status:
    """``ok``; ``low``: the disk is nearly full; ``scarce``: the oldest readings are being given up;
    ``paused``: nothing is stored; ``failed``: the store cannot be used. Times in seconds."""

    state: StoreState = "ok"
    message: Message | None = None
    cause: Message | None = None
    """Why the store cannot be used."""
    since: UnixTime = UnixTime(0.0)
    size_bytes: int = 0
    free_bytes: int = 0
    oldest_reading: UnixTime | None = None
    waiting: int = 0
    """Updates that are not on disk yet."""
    lost: int = 0
    """Updates that could not be stored."""
    damaged: int = 0
    """How often something that was kept turned out to be damaged, in the last seven days."""
    put_aside: str = ""
    """The file of a damaged store, put aside in the last seven days; empty: there is none."""
    begun: UnixTime | None = None
    """When the store was begun in its place."""


NOTICES: dict[StoreState, Message] = {
    "low": Message("history_disk_low"),
    "scarce": Message("history_disk_scarce"),
    "paused": Message("history_disk_full"),
    "failed": Message("history_failed"),
}
DAMAGED = Message("history_damaged")


def damage_message(status: Status, shown: Callable[[UnixTime], str]) -> Message | None:
    """Message about history that is not shown because it was damaged; ``shown`` writes a time as text."""
    if status.begun is not None:
        return Message.of("history_put_aside", time=shown(status.begun), file=status.put_aside)
    return DAMAGED if status.damaged else None


def store_message(state: StoreState, cause: Message | None = None) -> Message | None:
    """How the store is; None while it is well."""
    if state == "ok" or cause is None:
        return NOTICES.get(state)
    return Message.of("history_because", notice=NOTICES[state], cause=cause)


def store_notice(status: Status, formats: Formats, now: UnixTime) -> Message | None:
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
