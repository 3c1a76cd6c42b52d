"""What a recipe is, whether it can be loaded now, what loading it will do, what departed from it since."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

from app.commands.measure import measure_of_setpoint
from app.commands.review.ramp import ramp_of
from app.commands.review.risks import Remark, RiskInputs, facts_of, obstacle_of, risks_of
from app.live.state.bus_live import BusLive, UnitLive
from bus.catalogue.numbers import DECIMALS, FOLLOWER_MODE, RATIO_SETPOINT
from bus.catalogue.values import ratio_text, speed_text
from bus.contract.durations import change_s

RecipeKind = Literal["speed", "ratio"]

NOT_CONFIGURED = "not in the configuration"


@dataclass(frozen=True, slots=True)
class RecipeSetpoint:
    """``raw``: display units of the unit, or ratio times 10000 for a follower."""

    unit: int
    raw: int
    kind: RecipeKind


@dataclass(frozen=True, slots=True)
class Recipe:
    """One version of a named set of setpoints; it never changes, a new version is saved beside it."""

    bus: str
    name: str
    comment: str
    who: str
    saved_at: float
    setpoints: tuple[RecipeSetpoint, ...]
    version: int = 0
    id: int = 0


@dataclass(frozen=True, slots=True)
class LoadStep:
    """What loading does to one unit. Texts of values are in ``measure``. ``ramp_s`` None where not known.

    ``words``: what will happen, a template for ``old``, ``new`` and ``seconds``.
    ``obstacle``: why it cannot be loaded now; empty when nothing stands in the way.
    """

    unit: int
    name: str
    raw: int
    old: str
    new: str
    ramp_s: float | None
    obstacle: str = ""
    words: str = ""
    measure: str = ""
    risks: tuple[Remark, ...] = ()

    @property
    def is_configured(self) -> bool:
        """Whether ``name`` is one that people have given."""
        return self.obstacle != NOT_CONFIGURED

    @property
    def sentence(self) -> str:
        """What will happen, in English."""
        seconds = "" if self.ramp_s is None else f"{self.ramp_s:.1f}"
        return self.words.format(old=self.old, new=self.new, seconds=seconds)


@dataclass(frozen=True, slots=True)
class DryRun:
    """``wire_s``: time on the wire at best; ``ramp_s``: the longest known ramp of any unit."""

    steps: tuple[LoadStep, ...]
    wire_s: float
    ramp_s: float | None

    @property
    def loadable(self) -> bool:
        """Whether every unit can take its setpoint."""
        return not any(step.obstacle for step in self.steps)


@dataclass(frozen=True, slots=True)
class RecipeDeparture:
    """A unit whose commanded value is no longer what the loaded recipe says, or that is gone."""

    unit: int
    name: str
    recipe: str
    now: str


def setpoint_kind(unit: UnitLive) -> RecipeKind | None:
    """What a setpoint of this unit is: by #8, None while that has not been read."""
    mode = unit.parameter_raw(FOLLOWER_MODE)
    if mode is None:
        return None
    return "speed" if mode == 0 else "ratio"


def setpoint_text(unit: UnitLive, setpoint: RecipeSetpoint) -> str:
    """The setpoint as the unit would show it; the bare integer while its decimals are not known."""
    if setpoint.kind == "ratio":
        return ratio_text(setpoint.raw)
    decimals = unit.parameter_raw(DECIMALS)
    return str(setpoint.raw) if decimals is None else speed_text(setpoint.raw, decimals)


def dry_run(recipe: Recipe, bus: BusLive, refusal: Callable[[int, int], str], now: float) -> DryRun:
    """``refusal(unit, raw)`` says why the desk would refuse a setpoint now, empty when it would not.
    ``now``: seconds since the epoch."""
    steps = tuple(_step(setpoint, bus, refusal, now) for setpoint in recipe.setpoints)
    ramps = [step.ramp_s for step in steps if step.ramp_s is not None]
    return DryRun(steps, change_s(len(steps), bus.baud), max(ramps, default=None))


def departures(recipe: Recipe, bus: BusLive, since: float = 0.0) -> list[RecipeDeparture]:
    """Units that no longer command what the recipe says. ``since``: when it was loaded."""
    found = (_departure(setpoint, bus.units.get(setpoint.unit), since) for setpoint in recipe.setpoints)
    return [departure for departure in found if departure is not None]


def _step(setpoint: RecipeSetpoint, bus: BusLive, refusal: Callable[[int, int], str], now: float) -> LoadStep:
    unit = bus.units.get(setpoint.unit)
    if unit is None:
        text = str(setpoint.raw)
        return LoadStep(
            setpoint.unit,
            f"unit {setpoint.unit}",
            setpoint.raw,
            "unknown",
            text,
            None,
            NOT_CONFIGURED,
        )
    present = present_raw(unit, setpoint.kind)
    ramp = ramp_of(unit, present, setpoint.raw)
    ramp_s = 0.0 if present == setpoint.raw else None if ramp is None else ramp.seconds
    facts = facts_of(bus, unit, now, ramp=ramp, setpoint=setpoint.raw)
    return LoadStep(
        unit=setpoint.unit,
        name=unit.settings.name,
        raw=setpoint.raw,
        old=_present_text(unit, setpoint.kind),
        new=setpoint_text(unit, setpoint),
        ramp_s=ramp_s,
        obstacle=_obstacle(setpoint, unit, facts) or refusal(setpoint.unit, setpoint.raw),
        words=_words(setpoint, present, ramp_s),
        measure=measure_of_setpoint(unit),
        risks=risks_of(facts),
    )


def _words(setpoint: RecipeSetpoint, present: int | None, ramp_s: float | None) -> str:
    """What will happen to a unit whose setpoint is ``present``."""
    if present is None:
        return "becomes {new}; what it has now is not known"
    if present == setpoint.raw:
        return "stays at {new}"
    if setpoint.kind == "ratio":
        return "follows at {new} of its master instead of {old}"
    way = "speeds up" if setpoint.raw > present else "slows down"
    return f"{way} from {{old}} to {{new}}" + ("" if ramp_s is None else " in {seconds} s")


def _obstacle(setpoint: RecipeSetpoint, unit: UnitLive, facts: RiskInputs) -> str:
    if obstacle := obstacle_of(facts):
        return obstacle.text
    kind = setpoint_kind(unit)
    if kind is None:
        return "its mode (#8) has not been read yet"
    if kind != setpoint.kind:
        return f"the recipe holds a {setpoint.kind}, the unit now takes a {kind} (#8)"
    return ""


def _present_text(unit: UnitLive, kind: RecipeKind) -> str:
    if unit.reading is None:
        return "unknown"
    present = present_raw(unit, kind)
    return (
        "unknown" if present is None else setpoint_text(unit, RecipeSetpoint(unit.settings.id, present, kind))
    )


def present_raw(unit: UnitLive, kind: RecipeKind) -> int | None:
    """What the unit is commanded now: CS of its last answer, or #37 for a ratio."""
    if kind == "ratio":
        return unit.parameter_raw(RATIO_SETPOINT)
    return unit.reading.commanded if unit.reading is not None else None


def _departure(setpoint: RecipeSetpoint, unit: UnitLive | None, since: float) -> RecipeDeparture | None:
    if unit is None:
        return RecipeDeparture(setpoint.unit, f"unit {setpoint.unit}", str(setpoint.raw), NOT_CONFIGURED)
    if not _told_since(unit, setpoint.kind, since):
        return None
    now = present_raw(unit, setpoint.kind)
    if now is None or now == setpoint.raw:
        return None
    shown = setpoint_text(unit, RecipeSetpoint(setpoint.unit, now, setpoint.kind))
    return RecipeDeparture(setpoint.unit, unit.settings.name, setpoint_text(unit, setpoint), shown)


def _told_since(unit: UnitLive, kind: RecipeKind, moment: float) -> bool:
    """#37 is read in the slow circle: what it said before the recipe was loaded says nothing about it."""
    if kind == "speed":
        return unit.reading is not None
    read = unit.parameters.get(RATIO_SETPOINT)
    return read is not None and read.at > moment


def setpoints_now(units: Iterable[UnitLive]) -> tuple[RecipeSetpoint, ...]:
    """The present setpoints of units that have told theirs, to begin a recipe from."""
    found: list[RecipeSetpoint] = []
    for unit in units:
        kind = setpoint_kind(unit)
        raw = present_raw(unit, kind) if kind is not None else None
        if kind is not None and raw is not None:
            found.append(RecipeSetpoint(unit.settings.id, raw, kind))
    return tuple(found)
