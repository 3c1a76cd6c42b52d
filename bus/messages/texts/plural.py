"""A text for one thing and for several."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias


class Plural(NamedTuple):
    """``one`` where the message's ``n`` is 1, else ``many``."""

    one: str
    many: str


EnglishText: TypeAlias = str | Plural
