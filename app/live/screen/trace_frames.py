"""A frame that passed the wire, as the page of a bus shows it, in the page's language."""

from __future__ import annotations

from typing import Any

from app.live.screen.fields import Translator
from bus.contract import LONGEST_MEANING, Frame


def frame_fields(frame: Frame, translator: Translator) -> dict[str, Any]:
    """``at``: seconds since the epoch; ``hex``: the bytes as they passed; ``meaning``: in the language of
    ``translator``."""
    return {
        "at": round(frame.at, 4),
        "direction": frame.direction,
        "hex": frame.data.hex(" ").upper(),
        "meaning": "; ".join(map(translator.t, frame.meanings))[:LONGEST_MEANING],
        "valid": frame.valid,
    }
