"""The texts and positions that pages show of units, buses, frames and causes, and the differences between two
states. Pure.

A group (``bus/unit``, ``bus``, ``line_summary``) has fields. A field is a short text, rendered once per
language for all browsers, or a list of typed values. Positions are fractions as text; bits are strings of
``0`` and ``1``, of which a lamp shows one place. An empty text means: not known.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

from app.core.messages import Language
from app.core.web.formats import MINUS, UNKNOWN, Formats
from app.line.conditions.catalogue import tile_check, tile_text
from app.line.conditions.condition import DRAW_DECIMALS, Draw
from app.line.live.bus_live import (
    BusLive,
    MotionState,
    UnitLive,
    bits_of,
    figures_now,
    follower,
    mode_of,
    offline_after_s,
    scan_s_of,
    setpoint_decimals,
    speed_decimals,
    stale_after_s,
)
from app.line.live.diagnosis import Cause
from bus.catalogue.parameters import (
    ANALOG_IN_HIGH,
    ANALOG_IN_LOW,
    AT_SPEED_WINDOW,
    DECIMALS,
    FOLLOWER_MODE,
    MAX_DISPLAY,
    RATIO_SETPOINT,
)
from bus.catalogue.values import RATIO_DECIMALS, StatusBits, analog_input_value
from bus.contract import MAX_MEANING, Frame, Progress, Reading, Stage, UnitFigures, UnitLinkState
from bus.errors import unit_error
from bus.instants import UnixTime
from bus.messages import Message

# English words, of which each reading shows some: `Language.term` translates a word 20 times as fast as a
# message.
STATE_WORDS: dict[MotionState, str] = {
    "": "not known",
    "at_speed": "at speed",
    "at_zero": "at zero",
    "ramping_up": "ramping up",
    "ramping_down": "ramping down",
    "off_speed": "off speed",
    "stopped": "stopped",
    "stopping": "still turning",
    "turning": "turning without run",
}
TURNING = "turning"
"""The word for a unit that turns without run, used beside a cause that names the run input."""
STOPPED_WITH_RUN = "stopped with run input on"
MODE_WORDS = {"": UNKNOWN, "remote": "REMOTE", "local": "LOCAL", "keylock": "KEYLOCK"}
STAGE_WORDS: dict[Stage, str] = {
    "waiting": "waiting for the bus",
    "sent": "sent",
    "searching": "addresses scanned:",
    "acknowledged": "acknowledged",
    "proving": "reading back",
}


Fields = dict[str, Any]
"""The fields of a group: a text, or a list for a script of the page (``setpoint``: [raw, decimals])."""
Groups = dict[str, Fields]
K = TypeVar("K")


def put_fields(shown: dict[K, Fields], group: K, fields: Fields) -> dict[K, Fields]:
    """Put ``fields`` into ``group`` of ``shown``; return those that differ, and no group if none does."""
    before = shown.setdefault(group, {})
    changed = {name: value for name, value in fields.items() if before.get(name) != value}
    before.update(changed)
    return {group: changed} if changed else {}


def merge_groups(groups: Groups, *later: Groups) -> Groups:
    """Put the fields of ``later`` groups into ``groups``, over earlier ones; return ``groups``."""
    for each in later:
        for group, fields in each.items():
            groups.setdefault(group, {}).update(fields)
    return groups


MEASURED = frozenset({"actual", "analog", "at", "deviation", "draw", "fill", "off"})
"""The fields of a unit that each reading may change even if all is well."""

DEVIATION_WINDOWS = 3
"""Half the width of a deviation bar in at-speed windows, which makes the band its middle third."""


@dataclass(frozen=True, slots=True)
class Translator:
    """The texts and formats of one language."""

    language: Language
    formats: Formats

    def t(self, text: str | Message, /, **values: object) -> str:
        return self.language.t(text, **values)

    def tn(self, one: str, many: str, n: int, /, **values: object) -> str:
        """Return the text for a count: ``one`` for exactly one, else ``many``, with ``{n}`` in it
        replaced."""
        return self.language.tn(one, many, n, **values)

    def isolated(self, text: str) -> str:
        """Return a name so that it can stand beside other text of this language."""
        return self.language.isolated(text)


def unit_key(bus: str, unit: int) -> str:
    return f"{bus}/{unit}"


def name_on_site(bus: str, name: str, buses: Collection[str]) -> str:
    """Return the name of a unit on the pages of a site. With several buses the bus comes first, because two
    of them may have a unit of that name."""
    return f"{bus} · {name}" if len(buses) > 1 else name


def unit_fields(bus: BusLive, unit: UnitLive, link: UnitLinkState, translator: Translator) -> Fields:
    """Return the fields of one unit, by its reading."""
    state = unit.motion.state
    fields = {"link": link, "staged": _staged(unit, translator), "ratio": _ratio(bus, unit, translator)}
    fields |= _scale(unit)
    reading = unit.reading
    if reading is None:
        return fields | _NEVER | {"state_text": translator.t(STATE_WORDS[""])}
    bits = bits_of(bus, reading)
    mode = mode_of(unit, bits)
    # One dictionary that grows: this runs 37 times a second, and | would make a new one at each step.
    fields |= _numbers(bus, unit, reading, translator)
    fields |= _positions(unit, reading)
    fields |= {
        "at": f"{reading.at:.2f}",
        "state": state,
        "state_text": _state_text(unit, translator),
        "mode": mode,
        "mode_text": MODE_WORDS[mode],
        "inputs": _inputs(bits),
        "outputs": _bits(*bits.outputs),
    }
    return fields


def draw_fields(draw: Draw, translator: Translator, *, both_run: bool) -> Fields:
    """Return the draw as ``+5.3 %``, and its state. It is empty, and in the state none, if there is none or
    one of the two sections stands or turns without run."""
    if draw.tenths is None or not both_run:
        unknown = draw.state == "unknown"
        return {"draw": UNKNOWN if unknown else "", "draw_state": "unknown" if unknown else "none"}
    shown = "unjudged" if draw.state in ("none", "ramping") else draw.state
    return {"draw": draw_text(draw.tenths, translator), "draw_state": shown}


def draw_text(tenths: int, translator: Translator) -> str:
    """Return a draw in tenths of a percent as text with its sign."""
    return f"{_signed(tenths, DRAW_DECIMALS, translator)} %"


def bus_fields(bus: BusLive, translator: Translator, now: UnixTime) -> Fields:
    """Return the figures of one bus, and how long the readings of its units count as fresh."""
    scan_s = scan_s_of(bus)
    cause = translator.t(bus.link.cause) if bus.link.cause is not None and bus.link.link == "closed" else ""
    # Without its worker the port counts as closed, and nobody knows whether it is.
    port = bus.link.link if bus.worker_connected else "unknown"
    fields = {
        "link": port,
        "link_text": translator.t(port),
        "baud": f"{bus.baud}",
        "carries": translator.t(Message.of("wire_capacity", baud=bus.baud)),
        "cause": cause,
        "worker": "1" if bus.worker_connected else "0",
        "stale_after": f"{stale_after_s(scan_s):.2f}",
        "offline_after": f"{offline_after_s(scan_s):.2f}",
        "scan": UNKNOWN,
        "rate": UNKNOWN,
        "wire": UNKNOWN,
        "wire_fill": "0",
        "one_more": UNKNOWN,
        "noise": UNKNOWN,
        "diagnosis": cause,
    }
    figures = figures_now(bus, now)
    if figures is None:
        return fields
    number = translator.formats.number
    return fields | {
        "scan": scan_text(translator, figures.scan_s),
        "rate": number(figures.scan_hz, 1),
        "wire": f"{number(100 * figures.wire_utilisation)} %",
        "wire_fill": f"{min(1.0, figures.wire_utilisation):.3f}",
        "one_more": f"{number(figures.scan_s_with_one_more, 2)} s",
        "noise": f"{figures.noise_bytes}",
        "diagnosis": " ".join(map(translator.t, figures.diagnosis)),
    }


def scan_text(translator: Translator, scan_s: float) -> str:
    """Return a scan time as text; unknown if it is 0 because no unit responds."""
    return f"{translator.formats.number(scan_s, 2)} s" if scan_s > 0 else UNKNOWN


def health_fields(figures: UnitFigures, translator: Translator) -> Fields:
    """Return the counters and response times of one unit, for its open page."""
    naks = [f"{count} x {translator.t(unit_error(code))}" for code, count in sorted(figures.naks.items())]
    median, most = figures.response_s_median, figures.response_s_max
    times = ""
    if median is not None and most is not None:
        shown = [translator.formats.number(1000 * seconds, 1) for seconds in (median, most)]
        times = translator.t(Message.of("response_times", median=shown[0], most=shown[1]))
    return {
        "responses": f"{figures.responses}",
        "timeouts": f"{figures.timeouts}",
        "checksums": f"{figures.checksum_errors}",
        "naks": ", ".join(naks) or "0",
        "answer_time": times,
    }


_NEVER: Fields = {
    "at": "",
    "actual": UNKNOWN,
    "commanded": UNKNOWN,
    "setpoint": [None, None],
    "deviation": UNKNOWN,
    "analog": UNKNOWN,
    "fill": "",
    "mark": "",
    "band": "",
    "off": "",
    "state": "",
    "mode": "",
    "mode_text": UNKNOWN,
    "inputs": "",
    "outputs": "",
}


def _numbers(bus: BusLive, unit: UnitLive, reading: Reading, translator: Translator) -> Fields:
    decimals, deviation = speed_decimals(bus, unit), reading.deviation
    if DECIMALS not in unit.parameters:
        # Its decimal point is not known: 1196 may be 119.6.
        unknown = dict.fromkeys(("actual", "commanded", "deviation"), UNKNOWN)
        return {**unknown, "setpoint": [None, None], "analog": _analog(unit, reading.analog, translator)}
    return {
        "actual": _speed(reading.actual, decimals, translator),
        "commanded": _speed(reading.commanded, decimals, translator),
        "setpoint": [reading.commanded, decimals],
        "deviation": UNKNOWN if deviation is None else _signed(deviation, decimals, translator),
        "analog": _analog(unit, reading.analog, translator),
    }


def _speed(raw: int | None, decimals: int | None, translator: Translator) -> str:
    return translator.t("implausible") if raw is None else translator.formats.fixed(raw, decimals)


def _state_text(unit: UnitLive, translator: Translator) -> str:
    """Return how a unit moves, and whether its numbers may be in another scale by now."""
    state = translator.t(STATE_WORDS[unit.motion.state])
    return f"{state} · {translator.t(Message('scale_being_read'))}" if unit.scale_is_old else state


def _staged(unit: UnitLive, translator: Translator) -> str:
    if unit.staged_unknown:
        return "?"
    return "" if unit.staged is None else translator.formats.fixed(unit.staged, setpoint_decimals(unit))


def _scale(unit: UnitLive) -> Fields:
    """Return what a setpoint is shown and bounded by, for the parts drawn with it; empty while unread."""
    decimals, span = unit.parameter_raw(DECIMALS), unit.parameter_raw(MAX_DISPLAY)
    mode = unit.parameter_raw(FOLLOWER_MODE)
    own = "" if mode is None else "ratio" if follower(unit) else "speed"
    is_read = own and decimals is not None and span
    return {"scale": f"{decimals}:{span}:{own}" if is_read else "", "follower": own}


def _ratio(bus: BusLive, unit: UnitLive, translator: Translator) -> str:
    """Return the ratio of a follower to its master; if its commanded speed is a speed, #37 as last read."""
    if not follower(unit):
        return ""
    if bus.settings.follower_speed == "speed":
        raw = unit.parameter_raw(RATIO_SETPOINT)
    else:
        raw = unit.reading.commanded if unit.reading is not None else None
    return "" if raw is None else translator.formats.fixed(raw, RATIO_DECIMALS)


def _signed(raw: int, decimals: int | None, translator: Translator) -> str:
    """Return a number with its sign, ``±`` for 0, so that all have the same width in any typeface."""
    sign = "+" if raw > 0 else MINUS if raw < 0 else "±"
    return sign + translator.formats.fixed(abs(raw), decimals)


def _analog(unit: UnitLive, atd: int, translator: Translator) -> str:
    low, high = unit.parameter_raw(ANALOG_IN_LOW), unit.parameter_raw(ANALOG_IN_HIGH)
    if low is None or high is None:
        return UNKNOWN
    span = abs(high - low)
    digits = 0 if span >= 200 else 1 if span >= 20 else 2
    return translator.formats.number(analog_input_value(atd, low, high), digits)


def _positions(unit: UnitLive, reading: Reading) -> Fields:
    span, window = unit.parameter_raw(MAX_DISPLAY), unit.parameter_raw(AT_SPEED_WINDOW)
    deviation = _deviation(reading, window or (span or 0) // 100)
    if not span:
        return {"fill": "", "mark": "", "band": "", "off": deviation}
    return {
        "fill": "" if reading.actual is None else f"{min(1.0, reading.actual / span):.4f}",
        "mark": "" if reading.commanded is None else f"{min(1.0, reading.commanded / span):.4f}",
        "band": f"{min(1.0, 2 * (window or 0) / span):.4f}",
        "off": deviation,
    }


def _deviation(reading: Reading, window: int) -> str:
    if window <= 0 or reading.deviation is None:
        return ""
    share = reading.deviation / (window * 2 * DEVIATION_WINDOWS)
    return f"{0.5 + max(-0.5, min(0.5, share)):.3f}"


def _inputs(bits: StatusBits) -> str:
    return _bits(bits.run, bits.estop_active, bits.preset, bits.reverse, bits.up, bits.down, bits.follower)


def _bits(*bits: bool) -> str:
    return "".join(["1" if bit else "0" for bit in bits])


def frame_fields(frame: Frame, translator: Translator) -> dict[str, Any]:
    """Return a frame for the trace: ``at`` in seconds since the epoch, ``hex``, its bytes, and its
    ``meaning``."""
    return {
        "at": round(frame.at, 4),
        "direction": frame.direction,
        "hex": frame.data.hex(" ").upper(),
        "meaning": "; ".join(map(translator.t, frame.meanings))[:MAX_MEANING],
        "valid": frame.valid,
    }


MINUTE_S, LONG_RAMP_S = 60, 120


class CauseTexts(NamedTuple):
    """The texts of a cause: the condition, ``since`` when (empty if unknown), both in one ``line``, and a
    ``brief`` text for a tile."""

    text: str
    since: str
    line: str
    brief: str


def cause_texts(cause: Cause, translator: Translator, now: UnixTime) -> CauseTexts:
    """Return ``Stopped: run input off``, ``since 02:22``, ``Stopped: run input off since 02:22``, and the
    first of them without its reason."""
    motion, what, why = _motion(cause, translator), _what(cause, translator), _why(cause, translator)
    since = _since(cause, translator, now)
    short = tile_text(f"{cause.code}_brief")
    brief = joined(motion, what if short is None else translator.t(short))
    return CauseTexts(
        joined(motion, what, why), since, joined(motion, f"{what} {since}".rstrip(), why), brief
    )


def _since(cause: Cause, translator: Translator, now: UnixTime) -> str:
    """Return since when a cause holds; empty for a ramp, which shows the time left."""
    onset = cause.onset
    if onset is None or cause.code == "ramping":
        return ""
    code = "cause_since" if onset.exact else "cause_since_at_least"
    return translator.t(Message.of(code, time=translator.formats.since(onset.at, now)))


def check_text(cause: Cause | None, translator: Translator) -> str:
    """Return what to check for a cause; empty if nothing is to be done."""
    check = None if cause is None else tile_check(cause.code)
    return "" if check is None else translator.t(check)


def joined(*parts: str) -> str:
    """Join parts that explain each other with colons, without empty ones; capitalize the text."""
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


def progress_text(progress: Progress, first: Progress, translator: Translator) -> str:
    """Return how far a command is; of a scan also about how long it goes on, by the time since its ``first``
    report."""
    text = translator.t(STAGE_WORDS[progress.stage])
    if progress.of > 1:
        text += f" {progress.done}/{progress.of}"
    if progress.stage != "searching" or progress.done == first.done:
        return text
    each_s = (progress.at - first.at) / (progress.done - first.done)
    left = math.ceil(each_s * (progress.of - progress.done))
    if left < LONG_RAMP_S:
        return f"{text} · {translator.t(Message.of('scan_seconds_left', n=left))}"
    return f"{text} · {translator.t(Message.of('scan_minutes_left', n=round(left / MINUTE_S)))}"


def _ramp(params: Mapping[str, Any], translator: Translator) -> Message:
    target = translator.formats.fixed(params["target_raw"], params["decimals"])
    left = params["seconds_left"]
    if not left:
        return Message.of("cause_ramping", target=target)
    if left < LONG_RAMP_S:
        return Message.of("cause_ramping_seconds", target=target, n=left)
    return Message.of("cause_ramping_minutes", target=target, n=round(left / MINUTE_S))
