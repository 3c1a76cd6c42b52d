"""The recipes of the site: stored, checked against the line as it is now, loaded as one change."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

from app.core.database import StoreConnection
from app.core.database.connection import upsert
from app.core.database.database import Tables, reading, writing
from app.core.web.access import Person, Role
from app.core.web.arrival import Deadline
from app.engineering.recipes import rules
from app.engineering.recipes.rules import (
    Recipe,
    RecipeDeparture,
    RecipeDryRun,
    RecipeDryRunStep,
    RecipeSetpoint,
)
from app.errors import Problem
from app.line.commands.catalogue import SET_LINE
from app.line.commands.rules import reason_of
from app.line.commands.service import CommandService
from app.line.commands.values import Scales, parse_scale, scale_text, setpoint_scale
from app.line.live.bus_live import BusLive, LiveState
from app.people.audit.acts import Act
from app.people.audit.log import EventLog
from bus.contract import Result, SetLine, SetSpeed
from bus.instants import Monotonic, UnixTime, unix_now
from bus.messages import Message

SAVE = Act("save_recipe", Role.ENGINEER, "recipe", "event_recipe_saved")
DELETE = Act("delete_recipe", Role.ENGINEER, "recipe", "event_recipe_retired")
LOAD = Act("load_recipe", SET_LINE.role, "recipe", "event_recipe_loaded")
"""Loading needs the role of the command to units; it is recorded when that is verified."""
ACTS = (SAVE, DELETE, LOAD)


@dataclass(frozen=True, slots=True)
class Loaded:
    """The recipe that was last loaded on a bus."""

    recipe: Recipe
    who: str
    at: UnixTime


class RecipeStore(Tables):
    """The tables of recipes with all their versions, and of the recipe last loaded on each bus."""

    @writing
    def save(self, connection: StoreConnection, recipe: Recipe) -> Recipe:
        """Store a new version, one above the highest of its name; return it with version and id."""
        (version,) = connection.execute(
            "SELECT coalesce(max(version), 0) + 1 FROM recipe WHERE bus = ? AND name = ?",
            (recipe.bus, recipe.name),
        ).fetchone()
        [(recipe_id,)] = connection.execute(
            "INSERT INTO recipe (bus, name, version, comment, who, saved_at)"
            " VALUES (?, ?, ?, ?, ?, ?) RETURNING id",
            (recipe.bus, recipe.name, version, recipe.comment, recipe.who, recipe.saved_at),
        )
        connection.executemany(
            "INSERT INTO recipe_row (recipe_id, unit, raw, kind, scale) VALUES (?, ?, ?, ?, ?)",
            [(recipe_id, one.unit, one.raw, one.kind, one.scale) for one in recipe.setpoints],
        )
        return replace(recipe, version=version, id=recipe_id)

    @reading
    def load(self, connection: StoreConnection, recipe_id: int) -> Recipe | None:
        """Return one version, or None if it does not exist."""
        return next(_recipes(connection, [recipe_id]), None)

    @reading
    def newest(self, connection: StoreConnection, bus: str | None = None) -> list[Recipe]:
        """Return the newest version of each recipe in use, by name."""
        found = connection.execute(
            "SELECT id FROM recipe AS mine WHERE retired = 0 AND (bus = :bus OR :bus IS NULL) AND version ="
            " (SELECT max(version) FROM recipe AS other WHERE other.bus = mine.bus"
            " AND other.name = mine.name) ORDER BY bus, name",
            {"bus": bus},
        )
        return list(_recipes(connection, [recipe_id for (recipe_id,) in found]))

    @reading
    def is_full(self, connection: StoreConnection, bus: str, name: str, most: int) -> bool:
        """Return whether a recipe of this name would exceed ``most`` recipes in use."""
        count, is_there = connection.execute(
            "SELECT count(DISTINCT name), coalesce(max(CASE WHEN name = ? THEN 1 END), 0)"
            " FROM recipe WHERE bus = ? AND retired = 0",
            (name, bus),
        ).fetchone()
        return count >= most and not is_there

    @reading
    def versions(self, connection: StoreConnection, bus: str, name: str) -> list[Recipe]:
        """Return all versions of one recipe, newest first."""
        found = connection.execute(
            "SELECT id FROM recipe WHERE bus = ? AND name = ? ORDER BY version DESC", (bus, name)
        )
        return list(_recipes(connection, [recipe_id for (recipe_id,) in found]))

    @writing
    def retire(self, connection: StoreConnection, bus: str, name: str) -> None:
        """Take a recipe out of the list; its versions stay on record."""
        connection.execute("UPDATE recipe SET retired = 1 WHERE bus = ? AND name = ?", (bus, name))

    @writing
    def mark_loaded(
        self, connection: StoreConnection, bus: str, recipe_id: int, who: str, at: UnixTime
    ) -> None:
        """Record that a recipe was loaded and verified. ``at``: seconds since the epoch."""
        connection.execute(
            upsert("loaded_recipe", ("bus",), ("recipe_id", "who", "loaded_at")),
            (bus, recipe_id, who, at),
        )

    @reading
    def loaded(self, connection: StoreConnection) -> dict[str, Loaded]:
        """Return, by bus, the recipe that was last loaded there."""
        marks = connection.execute("SELECT bus, recipe_id, who, loaded_at FROM loaded_recipe").fetchall()
        return {
            bus: Loaded(recipe, who, at)
            for bus, recipe_id, who, at in marks
            for recipe in _recipes(connection, [recipe_id])
        }


def _recipes(connection: StoreConnection, ids: Iterable[int]) -> Iterator[Recipe]:
    """Yield the versions that exist for these ids."""
    for recipe_id in ids:
        heads = connection.execute(
            "SELECT bus, name, comment, who, saved_at, version FROM recipe WHERE id = ?", (recipe_id,)
        )
        rows = connection.execute(
            "SELECT unit, raw, kind, scale FROM recipe_row WHERE recipe_id = ? ORDER BY unit", (recipe_id,)
        )
        setpoints = tuple(RecipeSetpoint(*row) for row in rows)
        for bus, name, comment, who, saved_at, version in heads:
            yield Recipe(bus, name, comment, who, saved_at, setpoints, version, recipe_id)


MAX_RECIPES = 1000
"""The most recipes in use on one bus; their list is not paged."""


class RecipeBook:
    """The service that saves, tries out and loads recipes, and knows each bus's last one."""

    def __init__(
        self, state: LiveState, commands: Mapping[str, CommandService], store: RecipeStore, events: EventLog
    ) -> None:
        self._state = state
        self._commands = commands
        self.store = store
        self._events = events
        self._loaded: dict[str, Loaded] = {}
        self._under_way: set[tuple[str, str | None]] = set()
        """The loads that are being sent, by sender and command id."""

    async def load_marks(self) -> None:
        """Read from the store the recipe that was last loaded on each bus."""
        self._loaded = await self.store.loaded()

    def loaded(self, bus: str) -> Loaded | None:
        """Return the recipe that was last loaded on a bus, if any."""
        return self._loaded.get(bus)

    def departed(self, bus: str) -> list[RecipeDeparture]:
        """Return the units whose setpoint has left the loaded recipe."""
        loaded = self._loaded.get(bus)
        return rules.departures(loaded.recipe, self._state.buses[bus], loaded.at) if loaded else []

    def loaded_words(self, bus: str) -> tuple[str, list[str | Message]] | None:
        """Return the name of the loaded recipe and of the units that have left it; None if none is loaded."""
        loaded = self._loaded.get(bus)
        return None if loaded is None else (loaded.recipe.name, [one.name for one in self.departed(bus)])

    async def save(
        self, person: Person, bus: str, name: str, comment: str, setpoints: Mapping[int, int]
    ) -> Recipe:
        """Save a new version. ``setpoints``: raw by unit. Raise Problem 403 or 422."""
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
        """Return the effect that loading the recipe now would have; send nothing."""
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
        """Load a recipe as one change: stage, broadcast, read back.

        ``left_out``: units that keep their present setpoint; ``scales``: those of the review, None without
        one. A ``command_id`` that this person has used before returns the result of that load: nothing is
        checked against the present line, and nothing is recorded.

        Raise Problem 409 if a unit that is not left out cannot take its setpoint, 422 if all are left out.
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
        key = await self._commands[bus].look_up(person, command_id)
        return key.is_used or (person.sender, command_id) in self._under_way

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
        """Record a recipe as loaded on its bus; ``left_out``: the names of units."""
        loaded = self._loaded[recipe.bus] = Loaded(recipe, person.name, unix_now())
        await self.store.mark_loaded(recipe.bus, recipe.id, loaded.who, loaded.at)
        await self._record(
            LOAD, person, recipe, Message.of("recipe_left_out", names=[*left_out]) if left_out else ""
        )

    def _refusal(self, person: Person, bus: str, unit: int, raw: int) -> Message | None:
        """Return the reason why this setpoint, if confirmed, would be refused now."""
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
    """Raise Problem 409 if a unit cannot take its setpoint now."""
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
