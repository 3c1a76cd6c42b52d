"""A frame that passed the wire, as the page of a bus shows it, in the page's language."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from app.live.screen.fields import Translator
from bus.clauses import LONGEST, filled
from bus.contract import Clause, Frame


def frame_fields(frame: Frame, voice: Translator) -> dict[str, Any]:
    """``at``: seconds since the epoch; ``hex``: the bytes as they passed; ``meaning``: in the language of
    ``voice``."""
    return {
        "at": round(frame.at, 4),
        "direction": frame.direction,
        "hex": frame.data.hex(" ").upper(),
        "meaning": "".join(
            _translated(clause, voice.language.fixed) + clause.then for clause in frame.clauses
        )[:LONGEST],
        "valid": frame.valid,
    }


def _translated(clause: Clause, term: Callable[[str], str]) -> str:
    """Only whole texts of the catalog are translated: a worker's words are neither matched against patterns
    nor used as a format. Words among the values are in English too."""
    values = {name: term(value) if isinstance(value, str) else value for name, value in clause.values.items()}
    return filled(term(clause.text), values)
