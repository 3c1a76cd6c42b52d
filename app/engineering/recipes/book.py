"""The recipes of the app: saved, checked against the line as it is, loaded as one change."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import partial
from typing import Literal

from app.core.web.admission.access import Person
from app.core.web.admission.arrival import Deadline
from app.engineering.recipes import rules
from app.engineering.recipes.acts import DELETE, LOAD, SAVE
from app.engineering.recipes.rules import (
    Recipe,
    RecipeDeparture,
    RecipeDryRun,
    RecipeDryRunStep,
    RecipeSetpoint,
)
from app.engineering.recipes.store import Loaded, RecipeStore
from app.errors import Problem
from app.line.commands.catalogue import SET_LINE
from app.line.commands.rules import reason_of
from app.line.commands.service.command_service import CommandService
from app.line.commands.values import Scales, parse_scale, scale_text, setpoint_scale
from app.line.live.state.bus_live import BusLive, LiveState
from app.people.audit.acts import Act
from app.people.audit.log import EventLog
from bus.contract import Result, SetLine, SetSpeed
from bus.instants import Monotonic, unix_now
from bus.messages import Message

MAX_RECIPES = 1000
"""In use on one bus; a list of them is not paged."""


class RecipeBook:
    """One for the app."""

    def __init__(
        self, state: LiveState, commands: Mapping[str, CommandService], store: RecipeStore, events: EventLog
    ) -> None:
        self._state = state
        self._commands = commands
        self.store = store
        self._events = events
        self._loaded: dict[str, Loaded] = {}
        self._under_way: set[tuple[str, str | None]] = set()
        """The loads that are being sent, each by its sender and id."""

    async def load_mark(self, bus: str) -> None:
        """Read which recipe was loaded last."""
        loaded = await self.store.loaded()
        self._loaded.pop(bus, None)
        if bus in loaded:
            self._loaded[bus] = loaded[bus]

    def loaded(self, bus: str) -> Loaded | None:
        """The recipe that a bus was loaded with last."""
        return self._loaded.get(bus)

    def departed(self, bus: str) -> list[RecipeDeparture]:
        """What has left the loaded recipe since."""
        loaded = self._loaded.get(bus)
        return (
            rules.departures(loaded.recipe, self._state.buses[bus], loaded.at) if loaded is not None else []
        )

    def loaded_words(self, bus: str) -> tuple[str, list[str | Message]] | None:
        """Name of the loaded recipe and of the units that have departed from it; None without one."""
        loaded = self._loaded.get(bus)
        return None if loaded is None else (loaded.recipe.name, [one.name for one in self.departed(bus)])

    async def save(
        self, person: Person, bus: str, name: str, comment: str, setpoints: Mapping[int, int]
    ) -> Recipe:
        """A new version. ``setpoints``: unit → raw. Raises Problem 403, 422 or 404."""
        SAVE.check(person)
        live = self._state.buses[bus]
        if await self.store.is_full(bus, name, MAX_RECIPES):
            raise Problem(422, "invalid", Message.of("too_many_recipes", bus=bus, most=MAX_RECIPES))
        rows = tuple(_setpoint(live, unit, raw) for unit, raw in sorted(setpoints.items()))
        recipe = await self.store.save(Recipe(bus, name, comment, person.name, unix_now(), rows))
        await self._record(SAVE, person, recipe)
        return recipe

    async def retire(self, person: Person, bus: str, name: str) -> None:
        """Take a recipe out of the list; its versions stay on record."""
        DELETE.check(person)
        versions = await self.store.versions(bus, name)
        if not versions:
            raise Problem(404, "unknown_recipe", Message.of("no_such_recipe", name=name, bus=bus))
        await self.store.retire(bus, name)
        await self._record(DELETE, person, versions[0])

    def try_out(self, person: Person, recipe: Recipe) -> RecipeDryRun:
        """What loading it now would do; nothing is sent."""
        refusal = partial(self._refusal, person, recipe.bus)
        return rules.dry_run(recipe, self._bus(recipe), refusal, unix_now())

    async def load(
        self,
        person: Person,
        recipe: Recipe,
        made_at: Monotonic,
        *,
        confirm: bool,
        command_id: str | None,
        left_out: Collection[int] = (),
        scales: Scales | None = None,
    ) -> Result:
        """Load it as one change: staged, broadcast, read back. ``left_out``: the units that keep their
        present setpoint. ``scales``: what its review was made with; None: there was none. With a
        ``command_id`` that this person has used the result of that load is given again: neither is the line
        judged as it is now, nor is the recipe noted as loaded a second time.

        Raises Problem 409 where another unit cannot take it, 422 where all are left out.
        """
        steps = self.try_out(person, recipe).steps
        taking = [step for step in steps if step.unit not in left_out]
        if not taking:
            raise Problem(422, "invalid", Message.of("recipe_all_left_out", name=recipe.name))
        if command_id is not None and await self._is_repeated(person, recipe.bus, command_id):
            return await self._send(person, recipe, taking, made_at, confirm, command_id, scales)
        _refuse_obstacles(recipe, taking)
        load = (person.sender, command_id)
        self._under_way.add(load)
        try:
            result = await self._send(person, recipe, taking, made_at, confirm, command_id, scales)
            if result.outcome == "verified":
                await self._mark(person, recipe, [step.name for step in steps if step.unit in left_out])
        finally:
            self._under_way.discard(load)
        return result

    async def _is_repeated(self, person: Person, bus: str, command_id: str) -> bool:
        is_known = await self._commands[bus].has_taken(person, command_id)
        return is_known or (person.sender, command_id) in self._under_way

    async def _send(
        self,
        person: Person,
        recipe: Recipe,
        taking: Sequence[RecipeDryRunStep],
        made_at: Monotonic,
        confirm: bool,
        command_id: str | None,
        scales: Scales | None,
    ) -> Result:
        action = SetLine(setpoints={step.unit: step.raw for step in taking})
        return await self._commands[recipe.bus].send(
            person,
            action,
            deadline=Deadline(made_at, SET_LINE.timeout_s(action, self._bus(recipe))),
            confirm=confirm,
            id=command_id,
            origin=Message.of("origin_recipe", name=recipe.name),
            scales=scales or {step.unit: parse_scale(step.scale) for step in taking if step.scale},
        )

    async def _mark(self, person: Person, recipe: Recipe, left_out: Sequence[str | Message]) -> None:
        """Note that it is the loaded one of its bus; ``left_out``: the names of units."""
        loaded = self._loaded[recipe.bus] = Loaded(recipe, person.name, unix_now())
        await self.store.mark_loaded(recipe.bus, recipe.id, loaded.who, loaded.at)
        await self._record(
            LOAD, person, recipe, Message.of("recipe_left_out", names=[*left_out]) if left_out else ""
        )

    def _refusal(self, person: Person, bus: str, unit: int, raw: int) -> Message | None:
        """Why this setpoint would be refused now, confirmed as it will be; None when it would not."""
        try:
            self._commands[bus].check(person, SetSpeed(unit=unit, raw=raw), confirm=True)
        except Problem as problem:
            return reason_of(problem)
        return None

    async def _record(
        self, act: Act, person: Person, recipe: Recipe, message: Message | Literal[""] = ""
    ) -> None:
        performed = act.by(person, name=recipe.name, version=recipe.version)
        await self._events.record(**performed, bus=recipe.bus, message=message)

    def _bus(self, recipe: Recipe) -> BusLive:
        bus = self._state.buses.get(recipe.bus)
        if bus is None:
            raise Problem(409, "unknown_bus", Message.of("recipe_for_other_bus", bus=recipe.bus))
        return bus


def _refuse_obstacles(recipe: Recipe, steps: Sequence[RecipeDryRunStep]) -> None:
    """Raises Problem 409 where a unit cannot take its setpoint now."""
    why = [Message.of("of_unit", name=step.name, reason=step.obstacle) for step in steps if step.obstacle]
    if why:
        raise Problem(409, "not_loadable", Message.of("recipe_not_loadable", name=recipe.name, why=why))


def _setpoint(bus: BusLive, unit: int, raw: int) -> RecipeSetpoint:
    live = bus.units.get(unit)
    if live is None:
        raise Problem(422, "invalid", Message.of("recipe_unit_missing", bus=bus.settings.name, unit=unit))
    kind = rules.setpoint_kind(live)
    if kind is None:
        raise Problem(422, "invalid", Message.of("unit_mode_unknown", unit=unit))
    return RecipeSetpoint(unit, raw, kind, scale_text(setpoint_scale(live, raw)))
