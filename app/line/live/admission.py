"""How many pages or streams one account, or one address, may have open at a time.

Beyond the limit the newest is refused; to close an older page in its place would
make two browsers that reconnect by themselves push each other out without end.
"""

from __future__ import annotations

from collections import Counter

MAX_OF_ACCOUNT = 256
"""A browser opens no more WebSockets to one server than 255."""
MAX_OF_ADDRESS = 512
"""The browsers of a plant may share one address."""


class Admission:
    """Those that are open, counted."""

    def __init__(self, of_account: int = MAX_OF_ACCOUNT, of_address: int = MAX_OF_ADDRESS) -> None:
        self._of_account = of_account
        self._of_address = of_address
        self._by_account: Counter[str] = Counter()
        self._by_address: Counter[str] = Counter()

    def enter(self, account: str, address: str) -> bool:
        """Count one more, unless it is one too many. ``address``: as `source_of` names it."""
        if self._by_account[account] >= self._of_account or self._by_address[address] >= self._of_address:
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
