"""How history itself is: pages and the API say it whenever it is not well."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

State = Literal["ok", "low", "scarce", "paused", "failed"]


@dataclass(frozen=True, slots=True)
class Status:
    """``ok``; ``low``: the disk is nearly full; ``scarce``: the oldest readings are being given up;
    ``paused``: nothing is stored; ``failed``: the store cannot be used. Times in seconds."""

    state: State = "ok"
    message: str = ""
    since: float = 0.0
    size_bytes: int = 0
    free_bytes: int = 0
    oldest_reading: float | None = None
    waiting: int = 0
    """Updates that are not on disk yet."""
    lost: int = 0
    """Updates given up because they could not be stored."""


WORDS: dict[State, str] = {
    "ok": "",
    "low": "the disk with the history is nearly full: free some space soon",
    "scarce": "the disk with the history is nearly full: the oldest readings are being given up",
    "paused": "the disk is full: no readings are stored until some space is free",
    "failed": "history is off, everything else works",
}
