"""A frame that passed the wire, as the page of a bus shows it, in the page's language."""

from __future__ import annotations

from typing import Any

from app.live.fields import Voice
from bus.contract import Clause, Frame


def frame_fields(frame: Frame, voice: Voice) -> dict[str, Any]:
    """``at``: seconds since the epoch; ``hex``: the bytes as they passed; ``meaning``: in the language of
    ``voice``."""
    return {
        "at": round(frame.at, 4),
        "direction": frame.direction,
        "hex": frame.data.hex(" ").upper(),
        "meaning": "".join(_said(clause, voice) + clause.then for clause in frame.clauses),
        "valid": frame.valid,
    }


def _said(clause: Clause, voice: Voice) -> str:
    """Words among the values are in English too."""
    said = {
        name: voice.t(value) if isinstance(value, str) else value for name, value in clause.values.items()
    }
    return voice.t(clause.text, **said)
