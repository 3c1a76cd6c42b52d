"""Watches the tokens, and the certificates that the configuration names, for their ends."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from app.auth.store import Token
from app.conditions.of_server import CERTIFICATE_EXPIRING, TOKEN_EXPIRING
from app.errors import StoreError
from bus.certificate import MalformedCertificateError, certificates_in
from bus.instants import Clock, UnixTime, unix_now
from bus.messages import Message

LOOK_EVERY_S = 60.0
Expiry = tuple[UnixTime, str]
"""When something ends, and its name."""


class ExpiryWatch:
    """``token`` and ``certificate``: what ends first of those that are to be replaced; False: nothing, and
    None until it has looked."""

    def __init__(
        self,
        tokens: Callable[[], Awaitable[list[Token]]],
        authorities: Iterable[Path],
        clock: Clock = unix_now,
        *,
        certificates: Iterable[Path] = (),
    ) -> None:
        self._tokens = tokens
        self._ends = {**dict.fromkeys(authorities, max), **dict.fromkeys(certificates, min)}
        """Of several certificates in a file, the last to end may be the one that counts; of the server's
        and those that lead to its authority, all are needed."""
        self._clock = clock
        self.token: Message | Literal[False] | None = None
        self.certificate: Message | Literal[False] | None = None

    async def follow(self) -> None:
        """Look every minute, without end."""
        while True:
            with suppress(StoreError):
                await self.look()
            await asyncio.sleep(LOOK_EVERY_S)

    async def look(self) -> None:
        """Look once. Raises StoreError."""
        now = self._clock()
        self.token = _first(
            (token.expires_at, token.name)
            for token in await self._tokens()
            if token.expires_at is not None
            and TOKEN_EXPIRING.holds(token.created_at, token.expires_at, token.used_at, now)
        )
        endings = await asyncio.to_thread(lambda: [_ending(*each) for each in self._ends.items()])
        self.certificate = _first(
            each for each in endings if each and CERTIFICATE_EXPIRING.holds(each[0], now)
        )


def _first(endings: Iterable[Expiry]) -> Message | Literal[False]:
    at, name = min(endings, default=(None, ""))
    if at is None:
        return False
    day = datetime.fromtimestamp(float(at), UTC).date().isoformat()
    return Message.of("alarm_expires", name=name, day=day)


def _ending(path: Path, which: Callable[[Iterable[UnixTime]], UnixTime]) -> Expiry | None:
    """When the certificates of a file end. None for a file that holds none; who uses it reports that."""
    try:
        found = certificates_in(path.read_text(encoding="ascii", errors="replace"))
    except (OSError, MalformedCertificateError):
        return None
    return which(each.ends_at for each in found), path.name
