"""The review of a command on a page before it is confirmed, and its words once its result is known. Pure.

The review of a setpoint shows from where to where it goes, within which range, for how long, why the unit
cannot take it now, its risks, and what it does to the draw between neighboring sections. The review of
setting a line to zero shows which units take part, and which cannot.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Literal, NamedTuple

from app.errors import Problem
from app.line.commands.limits import HIGHEST_SETPOINT, Limits
from app.line.commands.rules import commanded_setpoint, kind_of, parameter_bounds, setpoint_range
from app.line.commands.values import (
    in_measure,
    measure_of_setpoint,
    parameter_message,
    scale_text,
    setpoint_message,
    setpoint_scale,
)
from app.line.conditions.condition import Draw, SectionSpeed, draw_between, percent_message, percent_of
from app.line.live.bus_live import (
    BusLive,
    UnitLive,
    bits_of,
    follower,
    quantity_of,
    ramp_parameter,
    ramp_seconds,
    unit_link_now,
)
from bus.catalogue.parameters import (
    ACCELERATION,
    DECELERATION,
    DECIMALS,
    MAX_DISPLAY,
    RATIO_SETPOINT,
    Parameter,
    Scale,
    nearest_legal,
)
from bus.contract import Outcome, Result, UnitOutcome, UnitScale
from bus.errors import CallerError, unit_error
from bus.instants import UnixTime
from bus.messages import Message, joined
from bus.settings import DrawBand, Seam

REVIEW_LASTS_S = 45.0
"""The seconds that a review lasts: thirty on the screen, and some time for the way to the server."""
COARSE_STEPS, FINE_STEPS = 100, 1000
"""A nudge is about a hundredth or a thousandth of the full span."""


@dataclass(frozen=True, slots=True)
class Ramp:
    """The ramp of a change. ``number``: the parameter that sets it, #6 or #7. ``tenths``: its raw value, for
    the full span (#2); ``seconds``: for this change. None if not known."""

    number: int
    tenths: int | None
    seconds: float | None


def ramp_of(unit: UnitLive, old: int | None, new: int) -> Ramp | None:
    """Return the ramp between two raw setpoints; None if nothing changes or the unit follows its master."""
    if old == new or follower(unit):
        return None
    number = ramp_parameter(old, new)
    tenths = None if old is None else unit.parameter_raw(number)
    return Ramp(number, tenths, ramp_seconds(unit, old, new))


def present_setpoint(bus: BusLive, unit: UnitLive) -> int | None:
    """Return the commanded setpoint; for a follower that shows its speed, the ratio as last read."""
    known = commanded_setpoint(unit, bus)
    return unit.parameter_raw(RATIO_SETPOINT) if known is None and follower(unit) else known


def ramp_parameters_missing(unit: UnitLive) -> list[int]:
    """Return the parameters to read before the time of a ramp is known."""
    return [number for number in (MAX_DISPLAY, ACCELERATION, DECELERATION) if number not in unit.parameters]


def nudges(unit: UnitLive) -> tuple[int, ...]:
    """Return the fine and the coarse raw step that suit the unit's span; none while that was not read, as a
    step of another size would be taken for the usual one."""
    span = 10_000 if follower(unit) else unit.parameter_raw(MAX_DISPLAY)
    return (_round_number(span / FINE_STEPS), _round_number(span / COARSE_STEPS)) if span else ()


def _round_number(size: float) -> int:
    """Return the largest of 1, 2, 5, 10, 20, … that is not above ``size``."""
    step = 1
    for candidate in (digit * 10**power for power in range(5) for digit in (1, 2, 5)):
        if candidate <= size:
            step = candidate
    return step


def obstacle_of(
    bus: BusLive, unit: UnitLive, now: UnixTime, *, block: Message | None = None
) -> Message | None:
    """Return the first reason why the unit cannot take a command now, because the next may disappear with it;
    None if there is none. ``block``: why commands to it are blocked."""
    if block:
        return Message.of("obstacle_blocked", block=block)
    if bus.link.link != "open":
        return Message("obstacle_no_link")
    if unit.reading is None or unit_link_now(bus, unit, now) == "offline":
        return Message("obstacle_offline")
    if not bits_of(bus, unit.reading).remote:
        return Message("obstacle_not_in_remote")
    return None


def risks_of(
    bus: BusLive, unit: UnitLive, now: UnixTime, ramp: Ramp | None, setpoint: int | None = None
) -> tuple[Message, ...]:
    """Return the risks of the unit's present state, in order of display. ``ramp`` None: the command starts
    none. ``setpoint``: the new one, raw, which an engineer's limit may allow although #2 does not."""
    found: list[Message] = []
    if setpoint is not None and _is_above_display(unit, setpoint):
        found.append(Message("risk_above_display"))
    if setpoint is not None and unit.staged not in (None, setpoint):
        found.append(Message.of("risk_staged", value=setpoint_message(unit.staged, unit)))
    if unit.reading is not None:
        if unit_link_now(bus, unit, now) == "stale":
            found.append(Message.of("risk_stale", age=round(max(0.0, now - unit.reading.at))))
        bits = bits_of(bus, unit.reading)
        if bits.estop_active:
            found.append(Message("risk_estop_active"))
        if not bits.run:
            found.append(Message("risk_run_off"))
    if ramp is not None and ramp.tenths == 0:
        found.append(Message("risk_no_ramp"))
    if ramp is not None and ramp.seconds is None:
        found.append(Message("risk_ramp_unknown"))
    return tuple(found)


def is_held(risks: Iterable[Message]) -> bool:
    """Return whether risks have it that a new setpoint does not take effect now."""
    return any(risk.code in ("risk_estop_active", "risk_run_off") for risk in risks)


def _is_above_display(unit: UnitLive, raw: int) -> bool:
    """Return whether a speed is above #2, which only an engineer's limit allows."""
    return kind_of(unit) == "speed" and raw > (unit.parameter_raw(MAX_DISPLAY) or HIGHEST_SETPOINT)


def by_remark(remarks: Iterable[tuple[str, Message]]) -> list[tuple[Message, list[str]]]:
    """Group units by remark: each remark once, with the names of its units, in order."""
    found: dict[Message, list[str]] = {}
    for name, remark in remarks:
        found.setdefault(remark, []).append(name)
    return list(found.items())


@dataclass(frozen=True, slots=True)
class SetpointChange:
    """A new setpoint of a unit in a review. Texts are as the unit shows them, in ``measure``."""

    unit: int
    name: str
    old_raw: int | None
    new_raw: int
    old: str | Message
    new: str | Message
    measure: str
    lowest: str | Message
    highest: str | Message
    scale: str
    """The scale of the new setpoint, as the form of the review holds it."""
    ramp: Ramp | None
    obstacle: Message | None
    risks: tuple[Message, ...]


def change_of(
    bus: BusLive,
    unit: UnitLive,
    new_raw: int,
    limits: Limits,
    now: UnixTime,
    *,
    block: Message | None = None,
    typed_with: UnitScale | None = None,
) -> SetpointChange:
    """Describe setting ``new_raw``. ``block``: why commands to the unit are blocked, if they are;
    ``typed_with``: the scale of the setpoint, which the unit may not have any more."""
    old_raw, allowed = present_setpoint(bus, unit), setpoint_range(unit, limits)
    ramp = ramp_of(unit, _before_ramp(bus, unit, old_raw), new_raw)
    return SetpointChange(
        unit=unit.settings.id,
        name=unit.settings.name,
        old_raw=old_raw,
        new_raw=new_raw,
        old=setpoint_message(old_raw, unit),
        new=setpoint_message(new_raw, unit),
        measure=measure_of_setpoint(unit),
        lowest=setpoint_message(allowed.lowest, unit),
        highest=setpoint_message(allowed.highest, unit),
        scale=scale_text({**setpoint_scale(unit, new_raw), **(typed_with or {})}),
        ramp=ramp,
        obstacle=obstacle_of(bus, unit, now, block=block),
        risks=risks_of(bus, unit, now, ramp, new_raw),
    )


def _before_ramp(bus: BusLive, unit: UnitLive, setpoint: int | None) -> int | None:
    """Return the raw setpoint from which the next ramp starts: a unit that is held in emergency stop, or has
    no run signal, starts from standstill once that is over."""
    bits = None if unit.reading is None else bits_of(bus, unit.reading)
    return 0 if bits is not None and (bits.estop_active or not bits.run) else setpoint


@dataclass(slots=True)
class ZeroPlan:
    """The plan to set a bus to zero: every unit ramps to speed 0 by its own #7; followers keep their ratio
    and come down with their master. It is not an emergency stop: nothing on this link can run or stop a
    drive. ``units``: address → name. ``left_out`` and ``risks``: name, with its reason or risk."""

    bus: str
    units: dict[int, str] = field(default_factory=dict)
    followers: int = 0
    left_out: list[tuple[str, Message]] = field(default_factory=list)
    risks: list[tuple[str, Message]] = field(default_factory=list)
    seconds: float = 0.0
    """The seconds of the longest ramp to zero among those that are known (#2 and #7 were read)."""
    unknown: int = 0
    """The number of units whose ramp to zero is not known."""


def plan_zero(bus: BusLive, block: Callable[[int], Message | None], now: UnixTime) -> ZeroPlan:
    """Plan to set every master to 0 that can take it, the others each with a reason. ``block``: a function
    that returns why commands to a unit are blocked, None if they are not."""
    plan = ZeroPlan(bus.settings.name)
    for address, unit in bus.units.items():
        name, ramp = unit.settings.name, ramp_of(unit, present_setpoint(bus, unit), 0)
        if follower(unit):
            plan.followers += 1
        elif obstacle := obstacle_of(bus, unit, now, block=block(address)):
            plan.left_out.append((name, _left_running(bus, unit, obstacle, now)))
        else:
            plan.units[address] = name
            risks = risks_of(bus, unit, now, ramp)
            # Of many units a number says it.
            plan.risks += [(name, risk) for risk in risks if risk.code != "risk_ramp_unknown"]
            plan.seconds = max(plan.seconds, (ramp.seconds if ramp else None) or 0.0)
            plan.unknown += ramp is not None and ramp.seconds is None
    return plan


def _left_running(bus: BusLive, unit: UnitLive, obstacle: Message, now: UnixTime) -> Message:
    """Return why a unit is not set to zero, and that it keeps its speed where it runs."""
    reading = unit.reading
    if reading is None or not reading.actual or unit_link_now(bus, unit, now) != "online":
        return obstacle
    speed = in_measure(setpoint_message(reading.actual, unit), measure_of_setpoint(unit))
    return Message.of("left_running", reason=obstacle, speed=speed)


class DrawChange(NamedTuple):
    """A draw that changes. ``is_out``: whether it is out of the band that the site sets for it."""

    text: Message
    is_out: bool


def refused_parameter(
    unit: UnitLive, parameter: Parameter, error: CallerError | Problem, limits: Limits
) -> tuple[Message, Message | str]:
    """Return the reason why a typed value of a parameter is refused, and the nearest allowed value (empty if
    there is none). Both show values as the unit does, not raw."""
    nearest = None if parameter.scale is Scale.BAUD else getattr(error, "nearest", None)
    reason = error.message
    if isinstance(error, Problem):
        nearest = error.extra.get("nearest")
        reason = reason if parameter.secret else Message("out_of_range")
    if nearest is None or parameter.secret:
        return Message.of("nothing_sent", reason=reason), ""
    lowest, highest = parameter_bounds(unit, parameter.number, limits)
    shown = parameter_message(parameter, nearest_legal(parameter, min(max(nearest, lowest), highest)), unit)
    return Message.of("value_refused_nearest", reason=reason, value=shown), shown


def draw_changes(bus: BusLive, setpoints: Mapping[int, int]) -> list[DrawChange]:
    """Return each draw that these setpoints, raw by unit, move out of its band, or change without a band:
    what is out of its band first, what has no draw now after it, each in floor order, and in one line those
    beside a standing unit that stay as commanded. A unit without a new setpoint stays at its commanded speed.
    A follower has a ratio: nothing is known of its draw."""
    changes: list[tuple[bool, DrawChange]] = []
    staying: list[str] = []
    for unit, seam in bus.seams.items():
        pair = bus.units[seam.before], bus.units[unit]
        if setpoints.keys().isdisjoint((unit, seam.before)) or any(map(follower, pair)):
            continue
        now, then = _draw(bus, pair, seam, {}), _draw(bus, pair, seam, setpoints)
        if then.tenths is None or then.tenths == now.tenths or then.state == "in_band":
            continue
        is_out = then.state == "out_of_band"
        commanded = _draw(bus, pair, seam, _commanded(pair))
        if now.tenths is None and not is_out and then.tenths == commanded.tenths:
            staying.append(bus.units[unit].settings.name)
            continue
        text = _draw_text(*pair, setpoints, percent_message(percent_of(then.tenths), "+"))
        if now.tenths is not None:
            text = Message.of("draw_instead_of", text=text, now=percent_message(percent_of(now.tenths), "+"))
        if is_out:
            low, high = map(percent_message, seam.band)
            text = Message.of("draw_and_band", text=text, low=low, high=high)
        changes.append((now.tenths is None, DrawChange(text, is_out)))
    found = [change for _, change in sorted(changes, key=lambda each: (not each[1].is_out, each[0]))]
    return [*found, DrawChange(Message.of("draws_stay", names=staying), False)] if staying else found


def leaves_band(bus: BusLive, setpoints: Mapping[int, int]) -> bool:
    """Return whether setpoints, raw by unit, move a draw out of its band, or farther out than it is."""
    for unit, seam in bus.seams.items():
        pair = bus.units[seam.before], bus.units[unit]
        if setpoints.keys().isdisjoint((unit, seam.before)) or any(map(follower, pair)):
            continue
        now, then = _draw(bus, pair, seam, {}), _draw(bus, pair, seam, setpoints)
        if then.state == "out_of_band" and _excess(then, seam) > _excess(now, seam):
            return True
    return False


def _excess(draw: Draw, seam: Seam) -> Decimal:
    """Return by how much a draw is outside its band, in percent; 0 where it is not known."""
    if draw.tenths is None or not seam.band:
        return Decimal(0)
    low, high = seam.band
    return max(low - percent_of(draw.tenths), percent_of(draw.tenths) - high, Decimal(0))


def _commanded(units: Iterable[UnitLive]) -> dict[int, int]:
    """Return the commanded setpoints, raw by unit, also of those that stand."""
    return {
        unit.settings.id: unit.reading.commanded
        for unit in units
        if unit.reading is not None and unit.reading.commanded is not None
    }


class DrawSeam(NamedTuple):
    """Two sections with a draw between their setpoints: the addresses, and its band in percent, or empty."""

    before: int
    unit: int
    band: DrawBand


def draw_seam(bus: BusLive, unit: int) -> DrawSeam | None:
    """Return the setpoints between which a unit has a draw; None if one of them is a ratio or has another
    quantity."""
    seam = bus.seams.get(unit)
    if seam is None:
        return None
    pair = bus.units[seam.before], bus.units[unit]
    quantities = {quantity_of(bus, each) for each in pair}
    if any(map(follower, pair)) or None in quantities or len(quantities) > 1:
        return None
    return DrawSeam(seam.before, unit, seam.band)


def _draw(bus: BusLive, pair: tuple[UnitLive, UnitLive], seam: Seam, setpoints: Mapping[int, int]) -> Draw:
    before, unit = pair
    return draw_between(_speed(bus, before, setpoints), _speed(bus, unit, setpoints), seam.band)


def _speed(bus: BusLive, unit: UnitLive, setpoints: Mapping[int, int]) -> SectionSpeed:
    """Return the speed of a section. A standing one keeps standing, whatever is commanded."""
    raw = setpoints.get(unit.settings.id)
    if raw is None and unit.reading is not None:
        raw = 0 if unit.reading.actual == 0 else unit.reading.commanded
    return SectionSpeed(raw, unit.parameter_raw(DECIMALS), quantity_of(bus, unit))


def _draw_text(before: UnitLive, unit: UnitLive, setpoints: Mapping[int, int], draw: Message) -> Message:
    names = {"name": unit.settings.name, "before": before.settings.name}
    if unit.settings.id not in setpoints:
        return Message.of("draw_after_stays", **names, speed=_stays_at(unit), draw=draw)
    if before.settings.id not in setpoints:
        return Message.of("draw_before_stays", **names, speed=_stays_at(before), draw=draw)
    return Message.of("draw_of_both", **names, draw=draw)


def _stays_at(unit: UnitLive) -> Message:
    commanded = None if unit.reading is None else unit.reading.commanded
    return in_measure(setpoint_message(commanded, unit), measure_of_setpoint(unit))


Tone = Literal["good", "bad", "unknown"]


@dataclass(frozen=True, slots=True)
class OutcomeText:
    """The result of a command in words. ``good``: as requested; ``bad``: not as requested, and nothing is
    half done; ``unknown``: not known."""

    tone: Tone
    text: Message


ResultRow = tuple[str, str | Message, OutcomeText]
"""A unit's name, the requested value and the result."""
_OUTCOMES: dict[Outcome, tuple[Tone, str]] = {
    "verified": ("good", "result_verified"),
    "acknowledged": ("good", "result_acknowledged"),
    "unverified": ("unknown", "result_no_response"),
    "refused": ("bad", "result_refused"),
    "not_sent": ("bad", "result_not_sent"),
    "bus_closed": ("bad", "result_bus_closed"),
    "invalid": ("bad", "outcome_invalid"),
}
_READ_BACK = {"verified": "result_reads", "unverified": "result_reads_other"}


def outcome_text(result: Result | UnitOutcome, shown: Callable[[int], str | Message] = str) -> OutcomeText:
    """Return words for the result of a command, or of a unit's part. ``shown``: words for a value."""
    tone, code = _OUTCOMES[result.outcome]
    if result.message and result.message.code == "nothing_sent":
        return OutcomeText("bad", result.message)
    if result.message and result.message.code in ("scale_changed_since", "unit_gave_too_little"):
        return OutcomeText("unknown", result.message)
    if result.message and _explains(result):
        return OutcomeText(tone, result.message)
    if result.outcome == "refused":
        reason = "" if result.unit_error is None else unit_error(result.unit_error)
        return OutcomeText(tone, Message.of(code, reason=reason))
    if result.read_back is not None and result.outcome in _READ_BACK:
        return OutcomeText(tone, Message.of(_READ_BACK[result.outcome], value=shown(result.read_back)))
    return OutcomeText(tone, Message(code))


def parameter_outcome(unit: UnitLive, parameter: Parameter, result: Result) -> OutcomeText:
    """Return words for the result of writing a parameter, its value as the unit shows it."""
    if parameter.secret and result.outcome == "unverified" and result.message:
        # This gives the reason in words: the value that was read back is not here.
        return OutcomeText("unknown", result.message)
    return outcome_text(result, lambda raw: parameter_message(parameter, raw, unit))


def _explains(result: Result | UnitOutcome) -> bool:
    """Return whether the message of a result replaces its usual text: if no unit has rejected it, if it
    states why nothing was sent, and if it states that one unit's part of a change is still staged."""
    if result.outcome == "refused":
        return result.unit_error is None
    in_part = isinstance(result, UnitOutcome) and result.read_back is None
    return result.outcome in ("invalid", "not_sent") or (in_part and result.outcome == "unverified")


MOST_NAMED = 3
"""The most units that the sentence of a result names; of the others it says how many."""


def failed_units(rows: Iterable[tuple[str, OutcomeText]]) -> list[Message]:
    """Name the units of a change that failed, each result once."""
    failed = [(name, outcome.text) for name, outcome in rows if outcome.tone != "good"]
    named = by_remark(failed[:MOST_NAMED])
    found = [Message.of("result_of_units", names=names, result=text) for text, names in named]
    more = len(failed) - MOST_NAMED
    return [*found, Message.of("result_of_more", n=more)] if more > 0 else found


def outcome_of_all(result: Result, rows: Mapping[int, tuple[str, OutcomeText]], n: int) -> OutcomeText:
    """Return the words for the outcome of a change of ``n`` units: how many of them are verified, and what
    became of each other one. ``rows``: name and result by unit, also of others that moved with it."""
    outcome = outcome_text(result)
    failed = joined(failed_units(rows.values()))
    if result.outcome not in ("verified", "unverified"):
        refused = [
            rows[each.unit] for each in result.units if each.unit in rows and each.outcome == "refused"
        ]
        return OutcomeText(outcome.tone, joined(failed_units(refused)) or outcome.text)
    if result.message is not None and result.message.code.startswith("no_unit_changed"):
        return OutcomeText(outcome.tone, result.message)
    if failed is None:
        return OutcomeText("good", Message.of("result_of_all", n=n))
    if not result.units:
        return outcome
    good = sum(words.tone == "good" for _, words in rows.values())
    some = Message.of("result_of_some", n=n, good=good)
    return OutcomeText(outcome.tone, joined((some, failed)) or some)


def outcome_message(result: Result | UnitOutcome) -> Message:
    """Return words for the result of a command, or of a unit's part, for programs and events."""
    if result.message:
        return result.message
    outcome = Message(f"outcome_{result.outcome}")
    if result.unit_error is None:
        return outcome
    return Message.of("outcome_because", outcome=outcome, reason=unit_error(result.unit_error))
