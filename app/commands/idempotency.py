"""Commands that were asked with an id, on disk: given again, also after a restart, it gives the same fate.

What is stored goes into the transaction of the command's own event, so an id is known exactly when the
intent is, which is before anything is sent. No HTTP.
"""

from __future__ import annotations

import hashlib
import sqlite3
from dataclasses import dataclass

import msgspec

from app.audit.log import ENDED_BEFORE
from app.commands.wish import Wish, writes_secret
from bus.contract import Action, Result, WriteParameter

KEPT_S = 7 * 86_400.0
"""Nobody asks again with an id of last week."""


@dataclass(frozen=True, slots=True)
class Earlier:
    """What an id stood for. ``command``: as :func:`command_of` gives it."""

    command: str
    fate: Result


def command_of(who: str, bus: str, action: Action) -> str:
    """Who asks what, so that two can be told apart: an id is its giver's own.

    Of a secret (#21) only that it is one.
    """
    if isinstance(action, WriteParameter) and writes_secret(action):
        action = msgspec.structs.replace(action, raw=0)
    return hashlib.sha256(f"{who}\0{bus}\0".encode() + msgspec.json.encode(action)).hexdigest()


def begin(connection: sqlite3.Connection, wish: Wish, now: float) -> None:
    """Its fate is open from here on; what is older than :data:`KEPT_S` is forgotten."""
    connection.execute("DELETE FROM asked WHERE asked_at < ?", (now - KEPT_S,))
    row = (wish.id, now, command_of(wish.person.account, wish.bus, wish.action))
    connection.execute("INSERT INTO asked (id, asked_at, command) VALUES (?, ?, ?)", row)


def end(connection: sqlite3.Connection, wish: Wish, result: Result) -> None:
    """Its fate, without the frames, which stand in the events."""
    told = msgspec.structs.replace(result, frames=[])
    if writes_secret(wish.action):
        told = msgspec.structs.replace(told, read_back=None)
    connection.execute("UPDATE asked SET fate = ? WHERE id = ?", (msgspec.json.encode(told), wish.id))


def find(connection: sqlite3.Connection, id: str) -> Earlier | None:
    """What became of it; what nobody knows any more, as the server ended meanwhile, is unverified."""
    row = connection.execute("SELECT asked_at, command, fate FROM asked WHERE id = ?", (id,)).fetchone()
    if row is None:
        return None
    asked_at, command, fate = row
    if fate is None:
        return Earlier(command, Result(id, asked_at, "unverified", ENDED_BEFORE))
    return Earlier(command, msgspec.json.decode(fate, type=Result))
