"""Acts and commands state their role once: for routes, for templates, and where they are done."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from inspect import isawaitable, signature
from itertools import product
from pathlib import Path
from typing import Any, get_args
from unittest.mock import MagicMock

import pytest

from app.core.web.access import Person, Requires, Role, public
from app.core.web.assets import Assets, static_dir, templates_dir
from app.core.web.routes import GuardedRoute, calls_of
from app.core.web.templating import Templates
from app.engineering.recipes.book import RecipeBook
from app.engineering.sets.batch import rows_of_batch, write_batch
from app.engineering.sets.restore_service import RestoreService
from app.engineering.sets.saving import SERVER, SetKeeper, SetReadings, SetSchedule
from app.engineering.swap.service import SwapService
from app.errors import Problem
from app.line.alarms.line_alarms import LineAlarms
from app.line.alarms.own_alarms import OwnAlarmBook
from app.line.commands.catalogue import COMMANDS, READ_PARAMETERS, kind_of_command, timeout_s_for
from app.line.commands.rules import NewSetpoint
from app.line.commands.safeguards import Safeguards
from app.main import FEATURES, create_app
from app.people.audit.acts import Act
from app.people.audit.log import Filter
from app.records.handover.service import Handover, Signing
from app.records.notification.service import Maintenance, Notification
from app.settings import Site
from bus.catalogue.parameters import PARAMETERS
from bus.contract import (
    Action,
    ChangeBaud,
    ExecuteAll,
    ExecuteSpeed,
    ReadParameters,
    ReadTrace,
    ScanBus,
    SetLine,
    SetSpeed,
    Staged,
    WriteAnalogOutput,
    WriteOutput,
    WriteParameter,
)
from bus.messages import Message
from tests.app.complete_app import House, settings_in
from tests.app.fake_worker import BUS, PlayedWorker, reading, responding
from tests.app.line.test_command_rules import bus_with, parameter
from tests.for_each import for_each

READS = {"GET", "HEAD"}
WITHOUT_AN_ACT = {
    ("POST", "/account/language"): "what a user sets for the own pages is no event",
    ("POST", "/trends/views"): "any user has own views; to share one is an act that the service checks",
    ("POST", "/trends/views/{number}/delete"): "any user has own views; of shared ones the service checks it",
    ("POST", "/api/v1/alarms/simulate"): "reads stored readings and changes nothing",
}
"""Routes that change something and name neither an act nor a command, with the reason."""
RETIRE = Act("retire", Role.ENGINEER, "recipe", "event_recipe_retired")
ACTS = [act for feature in FEATURES for act in feature.acts]


@pytest.mark.parametrize("role", Role)
def test_an_act_is_refused_to_every_role_that_does_not_include_its_own(role: Role) -> None:
    person = Person("anna", role, "session")
    if role.includes(Role.ENGINEER):
        RETIRE.check(person)
    else:
        with pytest.raises(Problem, match="role engineer") as refused:
            RETIRE.check(person)
        assert (refused.value.status, refused.value.code) == (403, "forbidden")


DONE_BY: dict[Role, dict[type[Any], str]] = {
    Role.OPERATOR: {
        Safeguards: "block lift take hand_over release request grant end_request",
        LineAlarms: "silence_sounding",
        Handover: "write",
        Signing: "sign",
    },
    Role.ENGINEER: {
        Safeguards: "set_limits",
        OwnAlarmBook: "add change remove",
        Maintenance: "begin end",
        Notification: "test",
        RecipeBook: "save retire",
        RestoreService: "plan select start cancel",
        SetKeeper: "read_and_save mark_golden",
        SetReadings: "begin",
        SetSchedule: "set",
        SwapService: "begin confirm_spare begin_restore save_entered cancel",
    },
    Role.ADMIN: {Safeguards: "set_read_only"},
}
"""The methods of services that do what a person wants, by the least role. `test_alarm_acts` has those of
alarms."""
BELOW = {Role.OPERATOR: Role.VIEWER, Role.ENGINEER: Role.OPERATOR, Role.ADMIN: Role.ENGINEER}


def methods_of(house: House, role: Role) -> Iterator[Callable[..., Any]]:
    """Each method of the table, for one role."""
    for kind, names in DONE_BY[role].items():
        service: Any = house.services[Notification].maintenance
        if kind is not Maintenance:
            of_bus = kind in (Safeguards, SetKeeper, SetSchedule)
            service = (house.services.buses[BUS] if of_bus else house.services)[kind]
        yield from (getattr(service, name) for name in names.split())


async def call(method: Callable[..., Any], person: Person) -> None:
    """Do it with arguments that have nothing to do with it."""
    _, *needed = (each for each in signature(method).parameters.values() if each.default is each.empty)
    done = method(person, *(MagicMock() for _ in needed))
    if isawaitable(done):
        await done


@for_each("role", DONE_BY)
async def test_a_caller_without_a_route_needs_the_role_too(house: House, role: Role) -> None:
    """It is looked at before anything of what is wanted."""
    before, person = (await house.log.page(Filter(), 99))[0], Person("ben", BELOW[role], "session")
    for method in methods_of(house, role):
        with pytest.raises(Problem, match=f"role {role}") as refused:
            await call(method, person)
        assert (refused.value.status, refused.value.code) == (403, "forbidden"), method
    assert (await house.log.page(Filter(), 99))[0] == before


def test_an_act_is_recorded_with_its_person_and_its_text() -> None:
    assert RETIRE.by(Person("anna", Role.ENGINEER, "token"), name="A", version=2) == {
        "kind": "recipe",
        "who": "anna",
        "origin": "token",
        "what": Message.of("event_recipe_retired", name="A", version=2),
    }


def test_an_act_without_a_text_is_refused() -> None:
    with pytest.raises(ValueError, match="act retire has no text: event_nothing"):
        Act("retire", Role.ENGINEER, "recipe", "event_nothing")


def test_templates_offer_each_act_to_its_role_and_those_above() -> None:
    templates = Templates(templates_dir(), Assets(static_dir()), Site())
    templates.permit({act.name: act.role for act in ACTS})
    for act in ACTS:
        for role in Role:
            assert templates.may(Person("anna", role, "session"), act.name) == role.includes(act.role)
    with pytest.raises(RuntimeError, match="two commands or acts are named save_recipe"):
        templates.permit({"save_recipe": Role.VIEWER})


def test_each_route_that_changes_something_names_what_a_person_does(tmp_path: Path) -> None:
    named = {act.name: act.role for act in ACTS}
    named |= {kind.request.__name__: kind.role for kind in COMMANDS.values()}
    unnamed = set[tuple[str, str]]()
    for route in create_app(settings_in(tmp_path)).routes:
        if not isinstance(route, GuardedRoute):
            continue
        requirements = list(calls_of(route))
        for method in (route.methods or set()) - READS:
            acts = {each.act: each.role for each in requirements if isinstance(each, Requires) and each.act}
            assert acts.items() <= named.items(), route.path
            if not acts and public not in requirements:
                unnamed.add((method, str(route.path)))
    assert unnamed == WITHOUT_AN_ACT.keys(), "name an act, or state why there is none"


SECRET = next(number for number, each in PARAMETERS.items() if each.secret)
ALL: list[Action] = [
    SetSpeed(unit=2, raw=5),
    ExecuteSpeed(unit=2),
    ExecuteAll(),
    SetLine(setpoints={2: 1, 1: 1}),
    WriteOutput(unit=2, number=1, on=True),
    WriteAnalogOutput(unit=2, raw=5),
    WriteParameter(unit=2, number=6, raw=50),
    ChangeBaud(baud=4800),
    ReadParameters(unit=2),
    ScanBus(),
    ReadTrace(since=0.0),
]


def test_every_action_has_one_row() -> None:
    assert COMMANDS.keys() == set(get_args(Action)) == {type(action) for action in ALL}


@pytest.mark.parametrize("action", ALL, ids=lambda action: type(action).__name__)
def test_what_writes_needs_an_operator_and_is_recorded(action: Action) -> None:
    kind = kind_of_command(action)
    assert kind.role.includes(Role.OPERATOR) or not action.writes
    assert kind.is_event(action) or not action.writes
    assert kind.wording(action, bus_with(reading(2))).what
    assert action.writes or not kind.units_written(action, bus_with())


@pytest.mark.parametrize(
    ("action", "named", "written"),
    [
        (SetSpeed(unit=2, raw=5), (2,), [2]),
        (WriteParameter(unit=1, number=6, raw=50), (1,), [1]),
        (SetLine(setpoints={2: 1, 1: 1}), (1, 2), [1, 2, 16]),
        (ExecuteAll(), (), [16]),
        (ChangeBaud(baud=4800), (), [1, 2, 16]),
        (ReadParameters(unit=2), (2,), []),
        (ScanBus(), (), []),
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_broadcast_reaches_what_others_have_staged(
    action: Action, named: tuple[int, ...], written: list[int]
) -> None:
    bus = bus_with(Staged(unit=16, at=0.0, raw=7))
    assert action.units == named
    assert list(kind_of_command(action).units_written(action, bus)) == written


def test_the_setpoints_that_a_command_would_bring_about() -> None:
    bus = bus_with(Staged(unit=16, at=0.0, raw=7), Staged(unit=2, at=0.0, raw=8))

    def of(action: Action) -> list[NewSetpoint]:
        return list(kind_of_command(action).setpoints(action, bus))

    assert of(SetSpeed(unit=1, raw=5)) == [NewSetpoint(1, 5)]
    assert of(SetSpeed(unit=1, raw=5, execute=False)) == [NewSetpoint(1, 5, is_staged=True)]
    assert of(SetLine(setpoints={2: 1, 1: 3})) == [NewSetpoint(1, 3), NewSetpoint(2, 1)]
    assert of(ExecuteAll()) == [NewSetpoint(2, 8), NewSetpoint(16, 7)]
    assert of(ExecuteSpeed(unit=16)) == [NewSetpoint(16, 7)]
    assert of(ExecuteSpeed(unit=1)) == []
    assert of(WriteParameter(unit=1, number=20, raw=5)) == [NewSetpoint(1, 5, "speed")]
    assert of(WriteParameter(unit=1, number=37, raw=5)) == [NewSetpoint(1, 5, "ratio")]
    assert of(WriteParameter(unit=1, number=6, raw=5)) == []
    assert of(WriteOutput(unit=1, number=1, on=True)) == []


def test_only_the_value_of_a_secret_is_hidden() -> None:
    hidden = [
        number
        for number in PARAMETERS
        if kind_of_command(action := WriteParameter(unit=1, number=number, raw=1)).is_secret(action)
    ]
    assert hidden == [SECRET]
    wording = kind_of_command(action).wording(
        WriteParameter(unit=1, number=SECRET, raw=1234), bus_with(parameter(1, SECRET, 4321))
    )
    assert (wording.old_raw, wording.new_raw) == (None, None)
    assert not {"1234", "4321"} & {wording.old, wording.new}


def test_a_search_is_an_event_and_a_look_at_one_address_is_none() -> None:
    search, look = ScanBus(first=1, last=9), ScanBus(first=9, last=9)
    assert kind_of_command(search).is_event(search)
    assert not kind_of_command(look).is_event(look)


def test_a_change_of_the_line_may_take_the_time_of_its_staging_and_a_list_of_parameters_its_own() -> None:
    bus = bus_with()
    times = {type(action): kind_of_command(action).timeout_s(action, bus) for action in ALL}
    assert times[SetLine] == timeout_s_for(bus, 2, typed=True) > times[SetSpeed] == timeout_s_for(bus)
    slow = ReadParameters(unit=2, urgent=False)
    assert times[ReadParameters] < kind_of_command(slow).timeout_s(slow, bus)


def test_a_change_of_several_is_worded_for_each_of_its_units() -> None:
    bus = bus_with(reading(1), reading(2), Staged(unit=16, at=0.0, raw=7))
    line, everything = SetLine(setpoints={2: 5, 1: 4}), ExecuteAll()
    parts = kind_of_command(line).part_wordings(line, bus)
    assert {unit: each.new_raw for unit, each in parts.items()} == {1: 4, 2: 5}
    assert list(kind_of_command(everything).part_wordings(everything, bus)) == [16]
    assert kind_of_command(ALL[0]).part_wordings(ALL[0], bus) == {}


async def code_of(site: House, person: Person, action: Action) -> str:
    """Send it as confirmed; return the code of the refusal, or the outcome."""
    try:
        return (await site.commands.send(person, action, confirm=True)).outcome
    except Problem as problem:
        return problem.code


@for_each("action, role", product(ALL, Role))
async def test_every_kind_is_sent_for_its_role_and_those_above_alone(
    site: House, worker: PlayedWorker, action: Action, role: Role
) -> None:
    worker.play = responding("verified")
    worker.commands.clear()
    person, needed = Person("anna", role, "session"), kind_of_command(action).role
    code = await code_of(site, person, action)
    assert (code == "forbidden") == (not role.includes(needed))
    if code == "forbidden":
        assert worker.commands == []
        with pytest.raises(Problem, match=f"role {needed}") as refused:
            site.commands.check(person, action, confirm=True)
        assert refused.value.status == 403


async def test_a_batch_of_a_person_without_the_right_writes_nothing(
    site: House, worker: PlayedWorker
) -> None:
    operator = Person("ben", Role.OPERATOR, "session")
    rows = rows_of_batch(site.live, 6, {1: "5.0", 2: "5.0", 16: "5.0"})
    results = await write_batch(site.commands, operator, 6, rows, "a", confirm=True)
    assert [isinstance(result.part, Problem) and result.part.code for result in results] == [
        "forbidden",
        False,
        False,
    ]
    assert worker.commands == []


def test_the_server_as_an_author_may_read_and_nothing_else() -> None:
    allowed = {kind.request for kind in COMMANDS.values() if SERVER.role.includes(kind.role)}
    assert allowed == {ReadParameters} == {READ_PARAMETERS.request}
