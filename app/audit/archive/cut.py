"""Where the log was cut: the end of archived events, sealed with the audit key. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import msgspec

from app.audit.proof.chain import Head
from app.audit.proof.keyring import KeyRing
from bus.instants import UnixTime


@dataclass(frozen=True, slots=True)
class Cut:
    """Entries ``first`` to ``last`` are in ``file``, whose SHA-256 is ``digest``. ``heads``: JSON of the ends
    of the chains at ``last``, from which the entries that stayed go on; ``first_hash``: of the first entry of
    the log; ``at``: when it was made."""

    last: int
    first: int
    file: str
    digest: str
    first_hash: str
    heads: str
    at: UnixTime
    key: str = ""
    seal: str = ""

    @property
    def ends(self) -> dict[str, Head]:
        """The ends of the chains at ``last``, by chain."""
        ends = msgspec.json.decode(self.heads, type=dict[str, tuple[int, str, str]])
        return {chain: Head(*end, chain=chain) for chain, end in ends.items()}

    def sealed(self, ring: KeyRing) -> Cut:
        """The same, sealed with the newest key."""
        return replace(self, key=ring.newest, seal=ring.seal("cut", *self._sealed_parts))

    def is_sealed(self, ring: KeyRing) -> bool:
        """Whether it was written with a key of the ring."""
        return ring.confirms(self.seal, self.key, "cut", *self._sealed_parts)

    @property
    def _sealed_parts(self) -> tuple[str, ...]:
        at = repr(float(self.at))
        return str(self.last), str(self.first), self.file, self.digest, self.first_hash, at, self.heads


def heads_text(ends: Mapping[str, Head]) -> str:
    """Ends of chains as `Cut.heads` has them."""
    plain: dict[str, Any] = {chain: (head.id, head.hash, head.key) for chain, head in sorted(ends.items())}
    return msgspec.json.encode(plain).decode()
