"""One unit, one bus, one frame as the texts and positions that a browser puts on the page. Pure.

A group (``bus/unit``, ``bus``, ``line``) has fields; a field is a short text, rendered here once per language
for all browsers, or a list of typed values. Positions are fractions as text; bits are strings of ``0`` and
``1``, of which a lamp shows one place. An empty text means: not known.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from app.core.messages import Language
from app.core.web.rendering.formats import MINUS, UNKNOWN, Formats
from app.line.conditions.draw import DRAW_DECIMALS, Draw
from app.line.live.screen.words import MODE_WORDS, STATE_WORDS
from app.line.live.state.age import figures_now
from app.line.live.state.bus_live import BusLive, UnitLive, follower, setpoint_decimals, speed_decimals
from app.line.live.state.conditions import bits_of, mode_of
from app.line.live.state.scan_time import offline_after_s, scan_s_of, stale_after_s
from bus.catalogue.numbers import (
    ANALOG_IN_HIGH,
    ANALOG_IN_LOW,
    AT_SPEED_WINDOW,
    MAX_DISPLAY,
    RATIO_SETPOINT,
)
from bus.catalogue.status import StatusBits
from bus.catalogue.values import RATIO_DECIMALS, analog_input_value
from bus.contract import MAX_MEANING, Frame, Reading, UnitFigures, UnitLinkState
from bus.errors import unit_error
from bus.instants import UnixTime
from bus.messages import Message

DEVIATION_WINDOWS = 3
"""Half the width of a deviation bar in at-speed windows, so that the band is its middle third."""

Fields = dict[str, Any]
"""Each a text, or a list that a script of the page reads: ``setpoint`` is [raw, decimals]."""


@dataclass(frozen=True, slots=True)
class Translator:
    """The texts of one language."""

    language: Language
    formats: Formats

    def t(self, text: str | Message, /, **values: object) -> str:
        return self.language.t(text, **values)

    def tn(self, one: str, many: str, n: int, /, **values: object) -> str:
        """The text for a count: ``one`` for exactly one, else ``many``; ``{n}`` in it is the count."""
        return self.language.tn(one, many, n, **values)

    def isolated(self, text: str) -> str:
        """A name beside other text, as it is put into a text of this language."""
        return self.language.isolated(text)


def unit_key(bus: str, unit: int) -> str:
    return f"{bus}/{unit}"


def name_on_site(bus: str, name: str, buses: Collection[str]) -> str:
    """The name of a unit on the pages of a site: where it has several buses, two may each have a unit of that
    name, and the bus comes first."""
    return f"{bus} · {name}" if len(buses) > 1 else name


def unit_fields(bus: BusLive, unit: UnitLive, link: UnitLinkState, translator: Translator) -> Fields:
    """What a page shows of one unit as it reads."""
    state = unit.motion.state
    fields = {"link": link, "staged": _staged(unit, translator), "ratio": _ratio(bus, unit, translator)}
    reading = unit.reading
    if reading is None:
        return fields | _NEVER | {"state_text": translator.t(STATE_WORDS[""])}
    bits = bits_of(bus, reading)
    mode = mode_of(unit, bits)
    # One dictionary that grows, thirty-seven times a second: | would make a new one at each step.
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


def draw_fields(draw: Draw, translator: Translator) -> Fields:
    """``draw``: as ``+5.3 %``, empty where there is none."""
    text = UNKNOWN if draw.state == "unknown" else ""
    return {
        "draw": text if draw.tenths is None else draw_text(draw.tenths, translator),
        "draw_state": draw.state,
    }


def draw_text(tenths: int, translator: Translator) -> str:
    """A draw in tenths of a percent, with its sign."""
    return f"{_signed(tenths, DRAW_DECIMALS, translator)} %"


def bus_fields(bus: BusLive, translator: Translator, now: UnixTime) -> Fields:
    """The figures of one bus, and for how long its units' readings count as fresh."""
    scan_s = scan_s_of(bus)
    cause = translator.t(bus.link.cause) if bus.link.cause is not None and bus.link.link == "closed" else ""
    fields = {
        "link": bus.link.link,
        "link_text": translator.t(bus.link.link),
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
    """A scan time; unknown where it is 0 because no unit responds."""
    return f"{translator.formats.number(scan_s, 2)} s" if scan_s > 0 else UNKNOWN


def health_fields(figures: UnitFigures, translator: Translator) -> Fields:
    """How one unit responds, for its open page."""
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
    """How it moves, and that its numbers may be in another scale by now."""
    state = translator.t(STATE_WORDS[unit.motion.state])
    return f"{state} · {translator.t(Message('scale_being_read'))}" if unit.scale_is_old else state


def _staged(unit: UnitLive, translator: Translator) -> str:
    if unit.staged_unknown:
        return "?"
    return "" if unit.staged is None else translator.formats.fixed(unit.staged, setpoint_decimals(unit))


def _ratio(bus: BusLive, unit: UnitLive, translator: Translator) -> str:
    """What a follower holds to its master: where its commanded speed is a speed, #37 as last read."""
    if not follower(unit):
        return ""
    if bus.settings.follower_speed == "speed":
        raw = unit.parameter_raw(RATIO_SETPOINT)
    else:
        raw = unit.reading.commanded if unit.reading is not None else None
    return "" if raw is None else translator.formats.fixed(raw, RATIO_DECIMALS)


def _signed(raw: int, decimals: int | None, translator: Translator) -> str:
    """Nothing too has its sign: the three are of one width in a typeface, where a space is not."""
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
    """``at``: seconds since the epoch; ``hex``: the bytes; ``meaning``: in the language of ``translator``."""
    return {
        "at": round(frame.at, 4),
        "direction": frame.direction,
        "hex": frame.data.hex(" ").upper(),
        "meaning": "; ".join(map(translator.t, frame.meanings))[:MAX_MEANING],
        "valid": frame.valid,
    }
