"""How many pages one account, or one address, may have open at a time.

Beyond the limit the newest is refused; to close an older page in its place would
make two browsers that reconnect by themselves push each other out without end.
"""

from __future__ import annotations

from collections import Counter

MOST_OF_ACCOUNT = 256
"""A browser opens no more WebSockets to one server than 255."""
MOST_OF_ADDRESS = 512
"""The browsers of a plant may share one address."""


class Admission:
    """The open pages, counted."""

    def __init__(self) -> None:
        self._by_account: Counter[str] = Counter()
        self._by_address: Counter[str] = Counter()

    def enter(self, account: str, address: str) -> bool:
        """Count one more page, unless it is one too many. ``address``: as `source_of` names it."""
        if self._by_account[account] >= MOST_OF_ACCOUNT or self._by_address[address] >= MOST_OF_ADDRESS:
            return False
        self._by_account[account] += 1
        self._by_address[address] += 1
        return True

    def leave(self, account: str, address: str) -> None:
        """One less of those that have entered."""
        for counter, key in ((self._by_account, account), (self._by_address, address)):
            counter[key] -= 1
            if not counter[key]:
                del counter[key]
