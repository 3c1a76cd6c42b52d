"""The rest of a limit, as response headers.

The three fields are those of the IETF draft "RateLimit header fields for HTTP" up to its version 6, which
clients and gateways read. Its later versions have one structured field, which few read, and are not yet an
RFC.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, floor

from bus.bucket import Bucket
from bus.instants import Monotonic


@dataclass(frozen=True, slots=True)
class RateLimit:
    """``limit``: so many at once; ``remaining``: of them now; ``reset_s``: until all are there again."""

    limit: int
    remaining: int
    reset_s: float

    @classmethod
    def of(cls, bucket: Bucket, now: Monotonic) -> RateLimit:
        """The limit of a bucket now."""
        level = bucket.level(now)
        return cls(floor(bucket.capacity), max(0, floor(bucket.capacity - level)), level / bucket.per_s)

    @property
    def headers(self) -> dict[str, str]:
        """By their names."""
        return {
            "RateLimit-Limit": str(self.limit),
            "RateLimit-Remaining": str(self.remaining),
            "RateLimit-Reset": str(ceil(self.reset_s)),
        }
