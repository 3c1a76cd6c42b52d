"""How history itself is: pages and the API say it whenever it is not well."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from app.web.formats import Formats
from bus.messages import Message

StoreState = Literal["ok", "low", "scarce", "paused", "failed"]


@dataclass(frozen=True, slots=True)
class Status:
    """``ok``; ``low``: the disk is nearly full; ``scarce``: the oldest readings are being given up;
    ``paused``: nothing is stored; ``failed``: the store cannot be used. Times in seconds."""

    state: StoreState = "ok"
    message: str = ""
    cause: str = ""
    """Why the store cannot be used."""
    since: float = 0.0
    size_bytes: int = 0
    free_bytes: int = 0
    oldest_reading: float | None = None
    waiting: int = 0
    """Updates that are not on disk yet."""
    lost: int = 0
    """Updates that could not be stored."""
    damaged: int = 0
    """How often something that was kept turned out to be damaged, in the last seven days."""


NOTICES: dict[StoreState, Message] = {
    "low": Message("history_disk_low"),
    "scarce": Message("history_disk_scarce"),
    "paused": Message("history_disk_full"),
    "failed": Message("history_failed"),
}
DAMAGED = Message("history_damaged")


def store_message(state: StoreState, cause: str = "") -> str:
    """How the store is, in English; empty while it is well."""
    if state == "ok":
        return ""
    return str(Message.of("history_because", notice=NOTICES[state], cause=cause) if cause else NOTICES[state])


def store_notice(status: Status, t: Callable[..., str], formats: Formats, now: float) -> str:
    """What people are told on the pages, in their language; empty while history is well."""
    since = formats.since(status.since, now)
    match status.state:
        case "ok":
            return t(DAMAGED) if status.damaged else ""
        case "failed":
            text = "No history is stored since {time}; everything else works. Cause: {why}"
            return t(text, time=since, why=status.cause)
        case "paused":
            return t("No history is stored since {time}: the disk is full. Free some space.", time=since)
        case _:
            return f"{t('History')}: {t(NOTICES[status.state])}"
