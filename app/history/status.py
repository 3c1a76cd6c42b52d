"""How history itself is: pages and the API say it whenever it is not well."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from app.web.formats import Formats

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
    """Updates given up because they could not be stored."""
    damaged: int = 0
    """How often something that was kept turned out to be damaged, in the last seven days."""


WORDS: dict[StoreState, str] = {
    "ok": "",
    "low": "the disk with the history is nearly full: free some space soon",
    "scarce": "the disk with the history is nearly full: the oldest readings are being given up",
    "paused": "the disk is full: no readings are stored until some space is free",
    "failed": "no history is kept, everything else works",
}


DAMAGED = (
    "History: something that was kept was damaged; the events say what is missing, the rest is whole. "
    "Check the disk."
)


def sentence(status: Status, t: Callable[..., str], formats: Formats, now: float) -> str:
    """What people are told on the pages, in their language; empty while history is well."""
    since = formats.since(status.since, now)
    match status.state:
        case "ok" if status.damaged:
            text = (
                "History: something that was kept was damaged; the events say what is missing, the rest is "
            )
            return t(text + "whole. Check the disk.")
        case "ok":
            return ""
        case "failed":
            text = "Since {time} no history is kept, everything else works. The reason: {why}"
            return t(text, time=since, why=status.cause)
        case "paused":
            return t("Since {time} no history is kept: the disk is full. Free some space.", time=since)
        case _:
            return f"{t('History')}: {t(status.message)}"
