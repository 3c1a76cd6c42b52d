"""A cause in the reader's language: the condition, since when, and what to check. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from app.live.diagnosis.cause import Cause
from app.live.screen.fields import Translator
from bus.instants import UnixTime
from bus.messages import Message

MINUTE_S, LONG_RAMP_S = 60, 120

CAUSE_TEXTS = {
    "estop_active": "emergency stop active",
    "run_off": "run input off",
    "running_without_run": "turning without run",
    "not_in_remote": "in {mode}",
    "link_stale": "response overdue",
    "unit_offline": "offline",
    "unit_unknown": "no response yet",
    "no_unit_yet": "no unit has responded yet",
    "no_unit_responds": "no unit responds",
    "port_lost": "port closed",
    "worker_lost": "bus worker not connected",
    "worker_silent": "bus worker does not respond",
    "address_suspect": "address uncertain",
    "blocked": "commands blocked",
}
"""By code. The motion of the unit precedes it (:data:`MOTION_TEXTS`), the reason follows; a drift has
only the reason."""
MOTION_TEXTS = {
    "stopped": "stopped",
    "stopping": "still turning",
    "turning": "turning",
    "off_speed": "off speed",
}
STOPPED_WITH_RUN = "stopped with run input on"
CHECK_TEXTS = {
    "estop_active": "Check the emergency stop chain of this unit",
    "run_off": "Check the run contact at the drive",
    "running_without_run": "Check what drives this section, and keep clear of it",
    "not_in_remote": "The unit rejects commands from here; set it to REMOTE at its panel",
    "link_stale": "Check its power and the cable",
    "unit_offline": "Check its power and the cable",
    "unit_unknown": "Check its power, its address and the cable",
    "port_lost": "Check the adapter and its cable",
    "worker_lost": "Check that the bus worker runs and reaches this server",
    "worker_silent": "Check that the bus worker runs and reaches this server",
    "address_suspect": "Check that every unit has a unique address (#17)",
    "not_at_speed": "Check the load and the speed feedback",
}
"""What a person does about it, by code; nothing where only time or a decision helps."""


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
    text = CHECK_TEXTS.get(cause.code, "") if cause is not None else ""
    return translator.t(text) if text else ""


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
    text = CAUSE_TEXTS.get(cause.code, "")
    return translator.t(text, **_named(cause)) if text else ""


def _named(cause: Cause) -> dict[str, Any]:
    return {"mode": cause.params["mode"]} if "mode" in cause.params else {}


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
