"""What every message between a bus worker and the app is, and the words that several of them use."""

from __future__ import annotations

from typing import Literal

import msgspec

CONTRACT_VERSION = 4
BUFFER_AGE_S = 7 * 86_400.0
"""How old an update may be that a worker kept while the app was away. An older one is refused."""

UnitLinkState = Literal["unknown", "online", "stale", "offline"]
BusLinkState = Literal["open", "closed"]
Outcome = Literal["verified", "acknowledged", "refused", "unverified", "invalid", "not_sent", "bus_closed"]
Stage = Literal["waiting", "sent", "searching", "acknowledged", "proving"]
Direction = Literal["out", "in"]


class TaggedStruct(msgspec.Struct, frozen=True, tag_field="is", omit_defaults=True):
    """Base of every message and part of a message: immutable, with its type in the field ``is``."""
