"""A message as data, and the English text of every code."""

from __future__ import annotations

from bus.messages.catalog import ENGLISH, Catalog
from bus.messages.message import (
    NUMBER,
    TERM,
    Message,
    ParamValue,
    in_english,
    joined,
    listed,
    number,
    shown,
    term,
)
from bus.messages.texts import TEXTS, Plural

__all__ = [
    "ENGLISH",
    "NUMBER",
    "TERM",
    "TEXTS",
    "Catalog",
    "Message",
    "ParamValue",
    "Plural",
    "in_english",
    "joined",
    "listed",
    "number",
    "shown",
    "term",
]
