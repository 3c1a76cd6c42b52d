"""Integers in the text of a request."""

from __future__ import annotations


def parse_integer(text: str, digits: int = 18) -> int | None:
    """The number that ``text`` writes with 1 to ``digits`` ASCII digits; None for anything else.

    ``int`` alone takes a sign, blanks, underscores and the digits of every script, and raises ValueError
    beyond 4300 of them.
    """
    return int(text) if text.isascii() and text.isdecimal() and len(text) <= digits else None
