"""Notices of changed rights, by which all servers of a site apply them within a moment of the commit.

A notice names an account. Who gets it reads the store: a false one makes a server look once too often, and
one that is lost is made up for by the polls of :class:`app.auth.rights.rights.Rights`."""

from __future__ import annotations

from typing import Literal, NamedTuple

from app.database import StoreConnection
from app.database.connection import notify

CHANNEL = "lineside_rights"
Kind = Literal["changed", "kept", "signed-out"]
"""``kept``: a user has chosen another password, which ends nothing but the other sessions; ``signed-out``:
the last session of a user has ended."""


class RightsNotice(NamedTuple):
    """``account`` empty: any of them."""

    kind: Kind
    account: str = ""


def announce(connection: StoreConnection, notice: RightsNotice) -> None:
    """Pass a notice to every server, once this transaction is committed."""
    notify(connection, CHANNEL, f"{notice.kind} {notice.account}")


def read(text: str) -> RightsNotice:
    """The notice of a text. An empty one states that notices may have been lost."""
    kind, _, account = text.partition(" ")
    match kind:
        case "changed" | "kept" | "signed-out":
            return RightsNotice(kind, account)
    return RightsNotice("changed")
