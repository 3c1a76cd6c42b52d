"""Text that people write for others to read: names, reasons, comments."""

from __future__ import annotations

import re
import unicodedata
from typing import Annotated

from pydantic import AfterValidator

from bus.messages import Message

_UNSEEN = frozenset(("Cc", "Cs", "Zl", "Zp"))
"""Categories of Unicode: control characters, halves of a pair, separators of lines."""
_JOINING = frozenset("\xad\u061c\u200c\u200d\u200e\u200f")
"""Format characters that scripts, emoji and hyphenation need between letters. The others hide, or turn the
text so that it reads differently from its characters."""
_BLANK = frozenset("\u115f\u1160\u2800\u3164\uffa0")
"""Letters and symbols without a shape."""
_MARKS = frozenset(("Mn", "Me"))
MAX_MARKS = 8
"""Combining characters in a row; more of them stack over what is shown above and below."""
_BREAKS = frozenset("\t\n\r")
_CREDENTIALS = re.compile(r"(://)\S+@")
MASK = "…"
"""In place of what is secret."""


def without_credentials(text: str) -> str:
    """The text with every URL in it without user and password."""
    return _CREDENTIALS.sub(rf"\1{MASK}@", text)


def composed(text: str) -> str:
    """The text with each accented letter as one character (NFC). Some keyboards and programs write it as two,
    which look the same and have to be equal."""
    return unicodedata.normalize("NFC", text)


OneLine = Annotated[str, AfterValidator(lambda text: _seen(text, frozenset()))]
"""A name or a reason."""
TypedText = Annotated[str, AfterValidator(composed)]
"""What a person types to find a name."""
Lines = Annotated[str, AfterValidator(lambda text: _seen(text, _BREAKS))]
"""A comment."""


def _seen(text: str, allowed: frozenset[str]) -> str:
    """Return the text, composed. Raises ValueError for an invisible character that is not allowed."""
    base = marks = 0
    for place, sign in enumerate(text, 1):
        if sign not in allowed and _is_unseen(sign):
            raise ValueError(Message.of("control_character", n=place, code=f"U+{ord(sign):04X}"))
        if unicodedata.category(sign) in _MARKS:
            marks += 1
        elif sign not in _JOINING:
            base, marks = place, 0
        if marks > MAX_MARKS:
            raise ValueError(Message.of("too_many_marks", n=base, most=MAX_MARKS))
    if text and not text.isspace() and not any(map(_has_shape, text)):
        raise ValueError(Message("nothing_to_see"))
    return composed(text)


def escaped(text: str) -> str:
    """The text with a backslash escape in place of each character that a terminal obeys or does not show;
    lines stay."""
    return "".join(
        sign.encode("unicode_escape").decode() if sign not in _BREAKS and _is_unseen(sign) else sign
        for sign in text
    )


def _is_unseen(sign: str) -> bool:
    category = unicodedata.category(sign)
    return category in _UNSEEN or (category == "Cf" and sign not in _JOINING)


def _has_shape(sign: str) -> bool:
    return unicodedata.category(sign)[0] in "LNPS" and sign not in _BLANK
