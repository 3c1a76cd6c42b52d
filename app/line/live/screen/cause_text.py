"""A cause in the reader's language: the condition, since when, and what to check. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from app.line.conditions.catalogue import tile_check, tile_text
from app.line.live.diagnosis.cause import Cause
from app.line.live.screen.fields import Translator
from app.line.live.screen.words import STATE_WORDS, STOPPED_WITH_RUN, TURNING
from bus.instants import UnixTime
from bus.messages import Message

MINUTE_S, LONG_RAMP_S = 60, 120


class CauseTexts(NamedTuple):
    """``text``: the condition; ``since``: its time, empty where none is known; ``line``: both in one."""

    text: str
    since: str
    line: str


def cause_texts(cause: Cause, translator: Translator, now: UnixTime) -> CauseTexts:
    """``Stopped: run input off``, ``since 02:22`` and ``Stopped: run input off since 02:22``."""
    motion, what, why = _motion(cause, translator), _what(cause, translator), _why(cause, translator)
    since = _since(cause, translator, now)
    return CauseTexts(joined(motion, what, why), since, joined(motion, f"{what} {since}".rstrip(), why))


def _since(cause: Cause, translator: Translator, now: UnixTime) -> str:
    """A ramp shows the time left instead."""
    onset = cause.onset
    if onset is None or cause.code == "ramping":
        return ""
    code = "cause_since" if onset.exact else "cause_since_at_least"
    return translator.t(Message.of(code, time=translator.formats.since(onset.at, now)))


def check_text(cause: Cause | None, translator: Translator) -> str:
    """What to check; empty where nothing is to be done."""
    check = None if cause is None else tile_check(cause.code)
    return "" if check is None else translator.t(check)


def joined(*parts: str) -> str:
    """Parts that explain each other as one text with a capital at its head; empty ones are left out."""
    text = ": ".join(part for part in parts if part)
    return text[:1].upper() + text[1:]


def _motion(cause: Cause, translator: Translator) -> str:
    motion = cause.params.get("motion", "")
    if not motion or cause.code == "not_at_speed":
        return ""
    return translator.t(TURNING if motion == "turning" else STATE_WORDS[motion])


def _what(cause: Cause, translator: Translator) -> str:
    if cause.code == "not_at_speed":
        stopped = cause.params.get("motion") == "stopped"
        return translator.t(STOPPED_WITH_RUN if stopped else STATE_WORDS["off_speed"])
    if cause.code == "ramping":
        return translator.t(_ramp(cause.params, translator))
    mode = cause.params.get("mode")
    text = tile_text(cause.code, **{"mode": mode} if mode else {})
    return "" if text is None else translator.t(text)


def _why(cause: Cause, translator: Translator) -> str:
    why = cause.params.get("why")
    return translator.t(why) if isinstance(why, Message) else why or ""


def _ramp(params: Mapping[str, Any], translator: Translator) -> Message:
    target = translator.formats.fixed(params["target_raw"], params["decimals"])
    left = params["seconds_left"]
    if not left:
        return Message.of("cause_ramping", target=target)
    if left < LONG_RAMP_S:
        return Message.of("cause_ramping_seconds", target=target, n=left)
    return Message.of("cause_ramping_minutes", target=target, n=round(left / MINUTE_S))
