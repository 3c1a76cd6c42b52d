"""A cause in the reader's language: the condition, since when, and what to check. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from app.conditions.catalogue import tile_check, tile_text
from app.live.diagnosis.cause import Cause
from app.live.screen.fields import Translator
from bus.instants import UnixTime
from bus.messages import Message

MINUTE_S, LONG_RAMP_S = 60, 120

MOTION_TEXTS = {
    "stopped": "stopped",
    "stopping": "still turning",
    "turning": "turning",
    "off_speed": "off speed",
}
STOPPED_WITH_RUN = "stopped with run input on"


def cause_text(cause: Cause, translator: Translator) -> str:
    """The condition without its time: ``Stopped: run input off``."""
    return joined(_motion(cause, translator), _what(cause, translator), _why(cause, translator))


def cause_line(cause: Cause, translator: Translator, now: UnixTime) -> str:
    """The condition and its time: ``Stopped: run input off since 02:22``."""
    what = f"{_what(cause, translator)} {since_text(cause, translator, now)}".rstrip()
    return joined(_motion(cause, translator), what, _why(cause, translator))


def since_text(cause: Cause, translator: Translator, now: UnixTime) -> str:
    """``since 02:22``; empty where no time is known. A ramp shows the time left instead."""
    onset = cause.onset
    if onset is None or cause.code == "ramping":
        return ""
    time = translator.formats.since(onset.at, now)
    return (
        translator.t("since {time}", time=time)
        if onset.exact
        else translator.t("since at least {time}", time=time)
    )


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
    return translator.t(MOTION_TEXTS[motion]) if motion and cause.code != "not_at_speed" else ""


def _what(cause: Cause, translator: Translator) -> str:
    if cause.code == "not_at_speed":
        return translator.t(
            STOPPED_WITH_RUN if cause.params.get("motion") == "stopped" else MOTION_TEXTS["off_speed"]
        )
    if cause.code == "ramping":
        return _ramp(cause.params, translator)
    mode = cause.params.get("mode")
    text = tile_text(cause.code, **{"mode": mode} if mode else {})
    return "" if text is None else translator.t(text)


def _why(cause: Cause, translator: Translator) -> str:
    why = cause.params.get("why")
    return translator.t(why) if isinstance(why, Message) else why or ""


def _ramp(params: Mapping[str, Any], translator: Translator) -> str:
    target = translator.formats.fixed(params["target_raw"], params["decimals"])
    left = params["seconds_left"]
    if not left:
        return translator.t("ramping to {target}", target=target)
    if left < LONG_RAMP_S:
        return translator.t("ramping to {target}, about {n} s left", target=target, n=left)
    return translator.t("ramping to {target}, about {n} min left", target=target, n=round(left / MINUTE_S))
