"""Recipes: obstacles to loading one now, the effect of a load, the units that left it since. Pure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field, InstanceOf, PlainSerializer

from app.core.web.shape import MessageObject
from app.line.commands.review import obstacle_of, ramp_of, risks_of
from app.line.commands.rules import SetpointKind, kind_of, setpoint_text
from app.line.commands.values import (
    differs,
    in_measure,
    measure_of_setpoint,
    parse_scale,
    scale_text,
    setpoint_scale,
)
from app.line.live.api.view import UnitAddress
from app.line.live.bus_live import BusLive, UnitLive, follower, unit_link_now
from bus.catalogue.parameters import DECIMALS, RATIO_SETPOINT
from bus.contract.actions import change_s
from bus.instants import UnixTime
from bus.messages import Message, number, term

SetpointRefusal = Callable[[int, int], Message | None]

NOT_CONFIGURED = Message("unit_not_configured")
RAW = term("raw")
"""The measure of a setpoint while the decimals of its unit are not known."""


@dataclass(frozen=True, slots=True)
class RecipeSetpoint:
    """The setpoint of one unit. ``raw``: display units, or ratio times 10000 for a follower. ``scale``: the
    scale that showed it when it was saved, as text; empty if not known."""

    unit: int
    raw: int
    kind: SetpointKind
    scale: str = ""


@dataclass(frozen=True, slots=True)
class Recipe:
    """A version of a named set of setpoints. It never changes: a change is saved as a new version."""

    bus: str
    name: str
    comment: str
    who: str
    saved_at: UnixTime
    setpoints: tuple[RecipeSetpoint, ...]
    version: int = 0
    id: int = 0


UnitName = Annotated[
    InstanceOf[Message] | str, PlainSerializer(str, return_type=str), Field(description="Name of the unit.")
]
RampS = Annotated[float | None, Field(description="Duration of the ramp, seconds; null: not known.")]


@dataclass(frozen=True, slots=True)
class RecipeDryRunStep:
    """The effect of loading a recipe on one unit."""

    unit: Annotated[UnitAddress, Field(serialization_alias="id")]
    name: UnitName
    raw: Annotated[int, Field(description="Setpoint on the wire, 0 to 99999.")]
    old: Annotated[MessageObject | None, Field(description="Present setpoint; null: not known.")]
    new: Annotated[str, Field(description="Setpoint of the recipe, as displayed.")]
    ramp_s: RampS
    obstacle: Annotated[MessageObject | None, Field(description="Why it cannot be set; null: it can.")]
    effect: Annotated[MessageObject | None, Field(description="The change; null: it is not configured.")] = (
        None
    )
    measure: Annotated[InstanceOf[Message] | str, Field(exclude=True)] = ""
    scale: Annotated[str, Field(exclude=True)] = ""
    risks: Annotated[tuple[MessageObject, ...], Field(exclude=True)] = ()


@dataclass(frozen=True, slots=True)
class RecipeDryRun:
    """The effect that loading a recipe now would have."""

    steps: Annotated[tuple[RecipeDryRunStep, ...], Field(serialization_alias="units")]
    wire_s: Annotated[float, Field(description="Duration on the wire at best, seconds.")]
    ramp_s: RampS
    loadable: Annotated[bool, Field(description="Whether every unit can take its setpoint.")]


@dataclass(frozen=True, slots=True)
class RecipeDeparture:
    """A unit that is gone or whose setpoint is no longer that of the recipe."""

    unit: Annotated[UnitAddress, Field(serialization_alias="id")]
    name: UnitName
    recipe: Annotated[str, Field(description="Setpoint of the recipe, as displayed.")]
    now: Annotated[MessageObject, Field(description="Present setpoint.")]


def setpoint_kind(unit: UnitLive) -> SetpointKind | None:
    """Return the kind of a unit's setpoint by #8; None while #8 was not read."""
    return None if follower(unit) is None else kind_of(unit)


def dry_run(recipe: Recipe, bus: BusLive, refusal: SetpointRefusal, now: UnixTime) -> RecipeDryRun:
    """Return the effect that loading a recipe would have. ``refusal(unit, raw)`` returns the reason why a
    setpoint would be refused now, or None."""
    steps = tuple(_step(setpoint, bus, refusal, now) for setpoint in recipe.setpoints)
    ramps = [step.ramp_s for step in steps if step.ramp_s is not None]
    loadable = not any(step.obstacle for step in steps)
    return RecipeDryRun(steps, round(change_s(len(steps), bus.baud), 3), max(ramps, default=None), loadable)


def departures(recipe: Recipe, bus: BusLive, since: UnixTime = UnixTime(0.0)) -> list[RecipeDeparture]:
    """Return the units whose setpoint differs from the recipe. ``since``: the time of the load."""
    found = (_departure(setpoint, bus.units.get(setpoint.unit), since) for setpoint in recipe.setpoints)
    return [departure for departure in found if departure is not None]


def _step(
    setpoint: RecipeSetpoint, bus: BusLive, refusal: SetpointRefusal, now: UnixTime
) -> RecipeDryRunStep:
    unit = bus.units.get(setpoint.unit)
    if unit is None:
        name, raw = Message.of("unit_address", unit=setpoint.unit), setpoint.raw
        return RecipeDryRunStep(setpoint.unit, name, raw, None, str(raw), None, NOT_CONFIGURED, measure=RAW)
    is_silent = unit.reading is None or unit_link_now(bus, unit, now) == "offline"
    present = None if is_silent else present_raw(unit, setpoint.kind)
    ramp = ramp_of(unit, present, setpoint.raw)
    ramp_s = 0.0 if present == setpoint.raw else None if ramp is None else ramp.seconds
    old = None if present is None else number(setpoint_text(unit, present, setpoint.kind))
    new = setpoint_text(unit, setpoint.raw, setpoint.kind)
    is_bare = setpoint.kind == "speed" and unit.parameter_raw(DECIMALS) is None
    measure = RAW if is_bare else measure_of_setpoint(unit)
    return RecipeDryRunStep(
        unit=setpoint.unit,
        name=unit.settings.name,
        raw=setpoint.raw,
        old=old,
        new=new,
        ramp_s=ramp_s,
        obstacle=_obstacle(setpoint, bus, unit, now) or refusal(setpoint.unit, setpoint.raw),
        effect=Message(
            _effect(setpoint, present, ramp_s),
            {
                "old": in_measure(old, measure) if old is not None else term("unknown"),
                "new": in_measure(new, measure),
                "seconds": number(f"{max(ramp_s or 0.0, 0.1):.1f}"),
            },
        ),
        measure=measure,
        scale=setpoint.scale or scale_text(setpoint_scale(unit, setpoint.raw)),
        risks=risks_of(bus, unit, now, ramp, setpoint.raw),
    )


def _effect(setpoint: RecipeSetpoint, present: int | None, ramp_s: float | None) -> str:
    """Return the message code of the effect on a unit whose setpoint is ``present``."""
    if present is None:
        return "recipe_sets"
    if present == setpoint.raw:
        return "recipe_keeps"
    if setpoint.kind == "ratio":
        return "recipe_changes_ratio"
    if setpoint.raw > present:
        return "recipe_speeds_up" if ramp_s is None else "recipe_speeds_up_within"
    return "recipe_slows_down" if ramp_s is None else "recipe_slows_down_within"


def _obstacle(setpoint: RecipeSetpoint, bus: BusLive, unit: UnitLive, now: UnixTime) -> Message | None:
    return obstacle_of(bus, unit, now) or why_not_setpoint(setpoint, bus)


def why_not_setpoint(setpoint: RecipeSetpoint, bus: BusLive) -> Message | None:
    """Return the reason why a setpoint does not fit its unit, however the unit is now; None if it fits."""
    unit = bus.units.get(setpoint.unit)
    if unit is None:
        return NOT_CONFIGURED
    kind = setpoint_kind(unit)
    if kind is None:
        return Message("recipe_mode_unread")
    if kind != setpoint.kind:
        return Message("recipe_holds_speed" if setpoint.kind == "speed" else "recipe_holds_ratio")
    if setpoint.scale and differs(parse_scale(setpoint.scale), unit):
        return Message("recipe_other_scale")
    return None


def present_raw(unit: UnitLive, kind: SetpointKind) -> int | None:
    """Return a unit's present setpoint: CS of its last response, or #37 for a ratio."""
    if kind == "ratio":
        return unit.parameter_raw(RATIO_SETPOINT)
    return unit.reading.commanded if unit.reading is not None else None


def _departure(setpoint: RecipeSetpoint, unit: UnitLive | None, since: UnixTime) -> RecipeDeparture | None:
    if unit is None:
        name = Message.of("unit_address", unit=setpoint.unit)
        return RecipeDeparture(setpoint.unit, name, str(setpoint.raw), NOT_CONFIGURED)
    if not _commanded_since(unit, setpoint.kind, since):
        return None
    now = present_raw(unit, setpoint.kind)
    if now is None or now == setpoint.raw:
        return None
    wanted, shown = (setpoint_text(unit, raw, setpoint.kind) for raw in (setpoint.raw, now))
    return RecipeDeparture(setpoint.unit, unit.settings.name, wanted, number(shown))


def _commanded_since(unit: UnitLive, kind: SetpointKind, moment: UnixTime) -> bool:
    """Return whether the setpoint was read after ``moment``; only the slow scan reads #37."""
    if kind == "speed":
        return unit.reading is not None
    read = unit.parameters.get(RATIO_SETPOINT)
    return read is not None and read.at > moment


def setpoints_now(bus: BusLive, now: UnixTime) -> tuple[RecipeSetpoint, ...]:
    """Return the present setpoints of the units that respond, as the start of a recipe."""
    return tuple(
        RecipeSetpoint(unit.settings.id, raw, kind, scale_text(setpoint_scale(unit, raw)))
        for unit in bus.units.values()
        if unit_link_now(bus, unit, now) != "offline"
        and (kind := setpoint_kind(unit))
        and (raw := present_raw(unit, kind)) is not None
    )
