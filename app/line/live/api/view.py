"""A unit, a bus and the line as the API shows them. Pure: the time is passed in.

Speeds are decimal texts in the unit's own decimals (#3), null while those are not known; a field that was
never read is null. ``…_raw`` are the integers on the wire.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from msgspec.structs import asdict

from app.core.web.shape import iso, maybe_shown, message_shown
from app.line.conditions.condition import DRAW_DECIMALS
from app.line.conditions.unit import suspicion
from app.line.live.bus_live import (
    BusLive,
    LiveState,
    UnitLive,
    draw_of,
    follower,
    scan_s_of,
    setpoint_decimals,
    speed_decimals,
    unit_link_now,
)
from app.line.live.diagnosis import Cause, unit_cause
from app.line.live.fields import Translator, cause_texts
from app.line.live.sources import Sources
from app.line.live.unit_status import bits_of, mode_of
from bus.catalogue.parameters import (
    ANALOG_IN_HIGH,
    ANALOG_IN_LOW,
    AT_SPEED_WINDOW,
    DECIMALS,
    MAX_DISPLAY,
    MAX_RPM,
    PARAMETERS,
)
from bus.catalogue.values import (
    analog_input_value,
    parameter_text,
    parameter_unit,
    plausible_parameter,
    rpm,
    speed_text,
)
from bus.contract import BusFigures, Reading, UnitFigures
from bus.errors import unit_error_name
from bus.instants import UnixTime
from bus.messages import Message

Json = dict[str, Any]

_NEVER_READ = dict.fromkeys(
    (
        *("read_at", "age_ms", "commanded_raw", "actual_raw", "deviation_raw"),
        *("commanded", "actual", "deviation", "rpm", "analog_raw", "analog"),
        *("at_speed", "remote", "mode", "outputs", "inputs", "implausible"),
    )
)
_NOT_MEASURED: Json = {
    **dict.fromkeys(("scan_hz", "scan_s", "scan_s_with_one_more", "wire_utilisation")),
    "diagnosis": [],
}


@dataclass(frozen=True, slots=True)
class LineView:
    """The line with its texts in English. Times are Unix times in seconds."""

    site: str
    live: LiveState
    sources: Sources
    english: Translator

    def line(self, now: UnixTime, only: str | None = None) -> Json:
        """Return every bus, or ``only`` one, with its units in floor order."""
        return {
            "site": self.site,
            "time": iso(now),
            "history": maybe_shown(self.sources.history_fault()),
            "buses": [self.bus(name, now) for name in self.live.buses if only in (None, name)],
        }

    def bus(self, name: str, now: UnixTime) -> Json:
        """Return one bus with its units."""
        bus = self.live.buses[name]
        return bus_fields(bus) | {"units": [self.unit(name, unit, now) for unit in bus.units]}

    def unit(self, name: str, number: int, now: UnixTime) -> Json:
        """Return one unit of a bus, with the age of its reading by the server's clock."""
        bus = self.live.buses[name]
        unit = bus.units[number]
        draw = draw_of(bus, unit, now)
        shown: Json = {
            "id": number,
            "name": unit.settings.name,
            "group": unit.settings.group,
            "labels": unit.settings.labels.model_dump(),
            "link": unit_link_now(bus, unit, now),
            "link_cause": maybe_shown(unit.link.cause),
            "cause": cause_json(unit_cause(bus, unit, now), now, self.english),
            "suspect": maybe_shown(suspicion(bus, unit)),
            "blocked": maybe_shown(self.sources.guards[name].block_reason(number)),
            "decimals": unit.parameter_raw(DECIMALS),
            "follower": follower(unit),
            "scale_current": not unit.scale_is_old,
            "staged_raw": unit.staged,
            "staged_unknown": unit.staged_unknown,
            "staged": None if unit.staged is None else setpoint_text(unit, unit.staged),
            "draw": None if draw.tenths is None else _signed_text(draw.tenths, DRAW_DECIMALS),
            "draw_state": draw.state,
            "at_speed_window_raw": unit.parameter_raw(AT_SPEED_WINDOW),
        }
        return shown | (_NEVER_READ if unit.reading is None else _reading_json(bus, unit, unit.reading, now))


def bus_fields(bus: BusLive) -> Json:
    """Return one bus without its units."""
    return wire_json(bus.figures) | {
        "name": bus.settings.name,
        "port": bus.settings.port,
        "baud": bus.baud,
        "link": bus.link.link,
        "link_cause": maybe_shown(bus.link.cause),
        "link_since": iso(bus.link_onset.at),
        "worker": bus.worker_connected,
        "scan_s_expected": scan_s_of(bus),
    }


def wire_json(figures: BusFigures | None) -> Json:
    """Return the measurements of the wire of a bus; null without figures."""
    if figures is None:
        return _NOT_MEASURED
    return {
        "scan_hz": figures.scan_hz,
        "scan_s": figures.scan_s or None,
        "scan_s_with_one_more": figures.scan_s_with_one_more,
        "wire_utilisation": figures.wire_utilisation,
        "diagnosis": [message_shown(each) for each in figures.diagnosis],
    }


_COUNTS = ("noise_bytes", "echoes", "updates_lost", "responds_for_all")


def figures_json(bus: str, figures: BusFigures | None) -> Json:
    """Return the figures of a bus; null if no worker measures them."""
    measured: Json = {name: getattr(figures, name, None) for name in _COUNTS} | wire_json(figures)
    units = [_statistics_json(unit) for unit in figures.units] if figures else []
    at = iso(figures.at) if figures else None
    return measured | {"bus": bus, "measured": figures is not None, "at": at, "units": units}


def _statistics_json(unit: UnitFigures) -> Json:
    naks = [
        {"unit_error": code, "unit_error_name": unit_error_name(code), "count": count}
        for code, count in sorted(unit.naks.items())
    ]
    return asdict(unit) | {"naks": naks}


def cause_json(cause: Cause | None, now: UnixTime, english: Translator) -> Json | None:
    """Return a cause as a code with parameters, in words, and since when; None without a cause."""
    if cause is None:
        return None
    why = cause.params.get("why")
    return {
        "code": cause.code,
        "params": {name: _plain(value) for name, value in cause.params.items()},
        "detail": cause_texts(cause, english, now).line,
        "why": message_shown(why) if isinstance(why, Message) else None,
        "since": None if cause.onset is None else iso(cause.onset.at),
        "since_exact": None if cause.onset is None else cause.onset.exact,
    }


def _plain(value: Any) -> Any:
    return str(value) if isinstance(value, Message) else value


def parameter_json(unit: UnitLive, number: int) -> Json:
    """Return one of the 40 parameters as last read; ``available`` null: not read yet. A secret is masked."""
    parameter = PARAMETERS[number]
    known = unit.parameters.get(number)
    raw = known.raw if known is not None else None
    is_implausible = plausible_parameter(number, raw) != raw
    return {
        "number": number,
        "name": parameter.name,
        "raw": None if parameter.secret else raw,
        "value": None if raw is None or is_implausible else _parameter_text(unit, number, raw),
        "unit": parameter_unit(parameter),
        "min": parameter.minimum,
        "max": parameter.maximum,
        "read_at": None if known is None else iso(known.at),
        "available": None if known is None else known.available,
        "type": parameter.type,
        "group": parameter.group,
        "meaning": parameter.meaning,
        "evidence": parameter.evidence,
        "choices": {str(value): name for value, name in parameter.choices.items()},
        "writable": not parameter.never_writable,
        "dangerous": parameter.dangerous,
        "masked": parameter.secret,
        "implausible": is_implausible,
    }


def setpoint_text(unit: UnitLive, raw: int) -> str | None:
    """Return a setpoint as the unit takes it, for a follower a ratio; None while decimals are not known."""
    return _speed_text(raw, setpoint_decimals(unit))


def _parameter_text(unit: UnitLive, number: int, raw: int) -> str:
    decimals = unit.parameter_raw(DECIMALS)
    return parameter_text(PARAMETERS[number], raw, decimals, follower=bool(follower(unit)))


def _reading_json(bus: BusLive, unit: UnitLive, reading: Reading, now: UnixTime) -> Json:
    bits = bits_of(bus, reading)
    decimals = speed_decimals(bus, unit)
    error = reading.deviation
    return {
        "read_at": iso(reading.at),
        "age_ms": max(0, round(1000 * (now - reading.at))),
        "commanded_raw": reading.commanded,
        "actual_raw": reading.actual,
        "deviation_raw": error,
        "commanded": _speed_text(reading.commanded, decimals),
        "actual": _speed_text(reading.actual, decimals),
        "deviation": None if decimals is None or error is None else _signed_text(error, decimals),
        "rpm": _rpm(unit, reading.actual),
        "analog_raw": reading.analog,
        "analog": _analog(unit, reading.analog),
        "at_speed": bits.at_speed,
        "remote": bits.remote,
        "mode": mode_of(unit, bits).upper(),
        "outputs": list(bits.outputs),
        "inputs": bits.inputs,
        "implausible": reading.implausible.hex(" ").upper() or None,
    }


def _speed_text(raw: int | None, decimals: int | None) -> str | None:
    return None if decimals is None or raw is None else speed_text(raw, decimals)


def _signed_text(raw: int, decimals: int) -> str:
    return ("-" if raw < 0 else "") + speed_text(abs(raw), decimals)


def _rpm(unit: UnitLive, raw: int | None) -> float | None:
    max_rpm, max_display = unit.parameter_raw(MAX_RPM), unit.parameter_raw(MAX_DISPLAY)
    if raw is None or max_rpm is None or not max_display:
        return None
    return round(rpm(raw, max_rpm, max_display), 1)


def _analog(unit: UnitLive, atd: int) -> float | None:
    low, high = unit.parameter_raw(ANALOG_IN_LOW), unit.parameter_raw(ANALOG_IN_HIGH)
    return None if low is None or high is None else round(analog_input_value(atd, low, high), 6)
